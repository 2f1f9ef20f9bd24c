"""How far a pixel may be off: the covariance of the intrinsics, propagated to projections.

A change of the intrinsics that a small turn of the camera undoes is no error of projection, for
whoever determines the pose uses the same intrinsics. Such a turn (and shift, at finite range) is
fitted to the corners that were observed and taken out; what remains is the uncertainty (the idea
is mrcal's; Kogan 2021, "differencing and uncertainty").
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from clothrf_calibration import rigid
from clothrf_calibration.boards import Board
from clothrf_calibration.intrinsics_fit import Fit, real_points
from clothrf_calibration.lens import directions, project_jacobian
from clothrf_core.types import Float

GRID = (19, 25)


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
    width, height = fit.views[0].size
    columns = np.linspace(0.0, width - 1.0, GRID[1])
    rows = np.linspace(0.0, height - 1.0, GRID[0])
    u, v = np.meshgrid(columns, rows)
    parameters = fit.state.parameters
    xy = directions(parameters, np.stack([u.ravel(), v.ravel()], axis=1))
    distance = 1.0 if np.isinf(range_m) else range_m
    place = np.concatenate([xy, np.ones((len(xy), 1))], axis=1)
    place *= distance / np.linalg.norm(place, axis=1, keepdims=True)
    turning = 3 if np.isinf(range_m) else 6
    undo = _undoing_motion(fit, real_points(fit, board), turning)
    _, by_point, by_parameter = project_jacobian(parameters, place)
    J = by_parameter - _by_motion(by_point, place)[:, :, :turning] @ undo
    n = parameters.size
    C = J @ fit.covariance[:n, :n] @ np.swapaxes(J, 1, 2)
    half = 0.5 * (C[:, 0, 0] + C[:, 1, 1])
    root = np.sqrt((0.5 * (C[:, 0, 0] - C[:, 1, 1])) ** 2 + C[:, 0, 1] ** 2)
    sd = np.sqrt(np.maximum(half + root, 0.0)).reshape(GRID)
    return UncertaintyMap(columns, rows, sd, range_m)


def _undoing_motion(fit: Fit, points: Float, turning: int) -> Float:
    """(3 or 6, P) motion of the camera that best undoes each change of a parameter."""
    H, g = np.zeros((turning, turning)), np.zeros((turning, fit.state.parameters.size))
    for view, mask, T in zip(fit.views, fit.inliers, fit.state.T_camera_board, strict=True):
        if not mask.any():
            continue
        local = points[view.ids[mask]] @ T[:3, :3].T + T[:3, 3]
        _, by_point, by_parameter = project_jacobian(fit.state.parameters, local)
        J = _by_motion(by_point, local)[:, :, :turning].reshape(-1, turning)
        H += J.T @ J
        g += J.T @ by_parameter.reshape(len(J), -1)
    return np.asarray(np.linalg.lstsq(H, g, rcond=1e-12)[0], float)


def _by_motion(by_point: Float, points: Float) -> Float:
    """(N, 2, 6) derivatives of pixels by turning and shifting the points."""
    return np.concatenate([-by_point @ rigid.skew(points), by_point], axis=2)
