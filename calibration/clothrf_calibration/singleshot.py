"""The quick form: a board at a measured place, seen by a standing camera."""

from __future__ import annotations

import dataclasses
from collections.abc import Sequence

import numpy as np

from clothrf_calibration import rigid
from clothrf_calibration.boardpose import fit_pose
from clothrf_calibration.errors import CalibrationError
from clothrf_calibration.handeye_fit import RobotNoise, covariance_of_inverse
from clothrf_calibration.lens import project_jacobian
from clothrf_calibration.views import View
from clothrf_core.types import Float

FEW = 10


@dataclasses.dataclass(frozen=True, slots=True, eq=False)
class SingleShot:
    """A camera pose from a board at a known place.

    Attributes:
        T_world_camera: (4, 4).
        covariance: (6, 6) left turn (rad) then shift (m), the place's own error included.
        rms: pixels.
        warnings: what the user should know.
    """

    T_world_camera: Float
    covariance: Float
    rms: float
    warnings: tuple[str, ...]


def single_shot(
    views: Sequence[View],
    points: Float,
    intrinsics: Float,
    T_world_board: Float,
    *,
    place: RobotNoise | None = None,
    intrinsics_covariance: Float | None = None,
) -> SingleShot:
    """The camera's pose from all `views` of a board that stands still at `T_world_board`.

    Args:
        views: of one board at one place; more of them average the corner noise.
        points: (P, 3) of the board.
        intrinsics: intrinsic vector.
        T_world_board: (4, 4) measured place.
        place: how exact that measurement is; 0.5 mm and 0.1 degrees an axis by default.
        intrinsics_covariance: of the intrinsics, to be propagated.

    Raises:
        CalibrationError: no board, or it moved between the pictures.
    """
    if not views:
        raise CalibrationError("expected at least one picture with the board, found none")
    place = place or RobotNoise(turn=np.radians(0.1), shift=5e-4)
    every = View(
        "all",
        views[0].size,
        np.concatenate([v.ids for v in views]),
        np.concatenate([v.pixels for v in views]),
    )
    T, residual = fit_pose(intrinsics, points, every)
    distance = np.linalg.norm(residual, axis=1)
    mask = distance < 4.5 * max(float(np.median(distance)) / 1.177, 0.02)
    T, residual = fit_pose(intrinsics, points, every, mask=mask)
    kept = residual[mask]
    each = [np.linalg.norm(fit_pose(intrinsics, points, v)[0][:3, 3] - T[:3, 3]) for v in views]
    rms = float(np.sqrt((kept**2).sum(axis=1).mean()))
    if len(views) > 1 and max(each) > 0.02:
        raise CalibrationError(
            f"expected a board that stands still, found it {1e3 * max(each):.0f} mm apart in "
            "different pictures; use `extrinsics` with robot poses, or one place only"
        )
    turned = points[every.ids[mask]] @ T[:3, :3].T
    _, by_point, by_parameter = project_jacobian(intrinsics, turned + T[:3, 3])
    J = np.concatenate([-by_point @ rigid.skew(turned), by_point], axis=2).reshape(-1, 6)
    inverse = np.asarray(np.linalg.inv(J.T @ J), float)
    C = inverse * float((kept**2).sum()) / max(kept.size - 6, 1)
    if intrinsics_covariance is not None:
        gain = -inverse @ J.T @ by_parameter.reshape(len(J), -1)
        C = C + gain @ intrinsics_covariance @ gain.T
    X = T_world_board @ rigid.inverse(T)
    covariance = _with_place(T, C, T_world_board, X, place)
    say = []
    if len(views) < FEW:
        say.append(f"only {len(views)} pictures; 30 of the same board average the noise out")
    say.append(
        f"the place of the board is taken to be exact to {place.shift * 1e3:g} mm and "
        f"{np.degrees(place.turn):g} degrees an axis; check the result with `verify`"
    )
    return SingleShot(X, covariance, rms, tuple(say))


def _with_place(T: Float, C: Float, W: Float, X: Float, place: RobotNoise) -> Float:
    """Covariance of X = W inv(T) from those of the picture and of the place."""
    inner = covariance_of_inverse(T, C)
    R = np.zeros((6, 6))
    R[:3, :3] = R[3:, 3:] = W[:3, :3]
    fixture = np.diag([place.turn**2] * 3 + [place.shift**2] * 3)
    lever = np.eye(6)
    lever[3:, :3] = -rigid.skew(X[:3, 3] - W[:3, 3])
    return np.asarray(R @ inner @ R.T + lever @ fixture @ lever.T)
