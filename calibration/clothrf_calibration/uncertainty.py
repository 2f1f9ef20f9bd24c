"""How far a pixel may be off: the covariance of the intrinsics, propagated to projections.

A change of the intrinsics that a small turn of the camera undoes is no error of projection, for
whoever determines the pose uses the same intrinsics. Such a turn (and shift, at finite range) is
fitted to the corners that were observed and taken out; what remains is the uncertainty (the idea
is mrcal's; Kogan 2021, "differencing and uncertainty").
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from clothrf_calibration import rigid
from clothrf_calibration.boardpose import fit_pose
from clothrf_calibration.boards import Board
from clothrf_calibration.intrinsics_fit import Fit, real_points
from clothrf_calibration.lens import directions, project_jacobian
from clothrf_calibration.views import View
from clothrf_core.types import Float

GRID = (19, 25)
FEWEST = 8  # corners of a view whose pose is worth knowing
MAX_SD_F = 1e-3
MAX_MEAN_PX, MAX_WORST_PX = 0.3, 1.0


@dataclass(frozen=True, slots=True, eq=False)
class UncertaintyMap:
    """Standard deviation of projections over the picture.

    Attributes:
        columns: (25,) pixel columns of the grid.
        rows: (19,) pixel rows of the grid.
        sd: (19, 25) pixels, in the worst direction.
        range_m: metres from the camera at which it holds; infinity = rotation only.
    """

    columns: Float
    rows: Float
    sd: Float
    range_m: float

    @property
    def mean(self) -> float:
        """Over the picture, pixels."""
        return float(self.sd.mean())

    @property
    def worst(self) -> float:
        """In the worst place, pixels."""
        return float(self.sd.max())


def uncertainty_map(fit: Fit, board: Board, *, range_m: float = np.inf) -> UncertaintyMap:
    """Uncertainty of projecting a point at `range_m` metres, over the whole picture."""
    n = fit.state.parameters.size
    points = real_points(fit, board)
    places = [
        points[view.ids[mask]] @ T[:3, :3].T + T[:3, 3]
        for view, mask, T in zip(fit.views, fit.inliers, fit.state.T_camera_board, strict=True)
        if mask.any()
    ]
    return projected_uncertainty(
        fit.state.parameters, fit.covariance[:n, :n], fit.views[0].size, places, range_m=range_m
    )


def stated_uncertainty(
    parameters: Float, covariance: Float, points: Float, views: Sequence[View]
) -> UncertaintyMap:
    """The same from numbers that were solved for earlier, seen by any views of the board.

    Args:
        parameters: (4 + D,) intrinsic vector.
        covariance: (4 + D, 4 + D) of it.
        points: (M, 3) corners of the board, metres.
        views: of that board.
    """
    places = []
    for view in views:
        if len(view.ids) >= FEWEST:
            T = fit_pose(parameters, points, view)[0]
            places.append(points[view.ids] @ T[:3, :3].T + T[:3, 3])
    return projected_uncertainty(parameters, covariance, views[0].size, places)


def projected_uncertainty(
    parameters: Float,
    covariance: Float,
    size: tuple[int, int],
    places: Sequence[Float],
    *,
    range_m: float = np.inf,
) -> UncertaintyMap:
    """Uncertainty of projections, less what a motion of the camera undoes.

    Args:
        parameters: (4 + D,) intrinsic vector.
        covariance: (4 + D, 4 + D) of it.
        size: width and height of the picture.
        places: (N, 3) observed corners of each view, metres, camera frame.
        range_m: metres from the camera at which it holds.
    """
    width, height = size
    columns = np.linspace(0.0, width - 1.0, GRID[1])
    rows = np.linspace(0.0, height - 1.0, GRID[0])
    u, v = np.meshgrid(columns, rows)
    xy = directions(parameters, np.stack([u.ravel(), v.ravel()], axis=1))
    distance = 1.0 if np.isinf(range_m) else range_m
    place = np.concatenate([xy, np.ones((len(xy), 1))], axis=1)
    place *= distance / np.linalg.norm(place, axis=1, keepdims=True)
    turning = 3 if np.isinf(range_m) else 6
    undo = _undoing_motion(parameters, places, turning)
    _, by_point, by_parameter = project_jacobian(parameters, place)
    J = by_parameter - _by_motion(by_point, place)[:, :, :turning] @ undo
    C = J @ covariance @ np.swapaxes(J, 1, 2)
    half = 0.5 * (C[:, 0, 0] + C[:, 1, 1])
    root = np.sqrt((0.5 * (C[:, 0, 0] - C[:, 1, 1])) ** 2 + C[:, 0, 1] ** 2)
    sd = np.sqrt(np.maximum(half + root, 0.0)).reshape(GRID)
    return UncertaintyMap(columns, rows, sd, range_m)


def uncertainty_warnings(parameters: Float, covariance: Float, found: UncertaintyMap) -> list[str]:
    """What is less certain than a rig needs, and what to do."""
    say = []
    relative = float((np.sqrt(np.diag(covariance))[:2] / parameters[:2]).max())
    if relative > MAX_SD_F:
        say.append(
            f"the focal length is uncertain by {100 * relative:.2f} % (aim: below "
            f"{100 * MAX_SD_F:.1f} %), {1e3 * relative:.1f} mm at 1 m; add tilted views"
        )
    if found.mean > MAX_MEAN_PX or found.worst > MAX_WORST_PX:
        say.append(
            f"projections are uncertain by {found.mean:.2f} px on average and "
            f"{found.worst:.2f} px in the worst corner (aim: {MAX_MEAN_PX} and "
            f"{MAX_WORST_PX}); stay inside the covered part or add views there"
        )
    return say


def _undoing_motion(parameters: Float, places: Sequence[Float], turning: int) -> Float:
    """(3 or 6, P) motion of the camera that best undoes each change of a parameter."""
    H, g = np.zeros((turning, turning)), np.zeros((turning, parameters.size))
    for local in places:
        _, by_point, by_parameter = project_jacobian(parameters, local)
        J = _by_motion(by_point, local)[:, :, :turning].reshape(-1, turning)
        H += J.T @ J
        g += J.T @ by_parameter.reshape(len(J), -1)
    return np.asarray(np.linalg.lstsq(H, g, rcond=1e-12)[0], float)


def _by_motion(by_point: Float, points: Float) -> Float:
    """(N, 2, 6) derivatives of pixels by turning and shifting the points."""
    return np.concatenate([-by_point @ rigid.skew(points), by_point], axis=2)
