"""The camera's pose from where the gripper *is*, without how it is turned.

The `Robot` interface tells positions only. A point of the gripper stands still in the board that
the gripper carries: ``p_i = X C_i z``, with p_i its position in the base, C_i the board's pose in
the camera, X = T_base_camera and z the point in the board's frame; X and z are solved for.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from scipy.optimize import least_squares

from clothrf_calibration import rigid
from clothrf_calibration.crossvalidation import folds
from clothrf_calibration.errors import DegenerateData
from clothrf_core.geometry import nearest_rotation, transform
from clothrf_core.types import Float

MIN_POINTS = 5
MAX_SD_MM = 20.0


@dataclass(frozen=True, slots=True, eq=False)
class PointFit:
    """A camera pose from gripper positions.

    Attributes:
        T_base_camera: (4, 4).
        point: (3,) the gripper's point in the board's frame, metres.
        covariance: (6, 6) left turn (rad) then shift (m).
        residual_mm: (V,) distances in the fit.
        held_out_mm: (V,) distances of views that took no part, by 5 folds.
        warnings: what the user should know.
    """

    T_base_camera: Float
    point: Float
    covariance: Float
    residual_mm: Float
    held_out_mm: Float
    warnings: tuple[str, ...]


def fit_points(positions: Float, C: Float) -> PointFit:
    """The camera's pose from (V, 3) gripper positions and (V, 4, 4) board poses.

    Raises:
        DegenerateData: too few or too similar poses.
    """
    if len(positions) < MIN_POINTS:
        raise DegenerateData(
            f"expected at least {MIN_POINTS} gripper positions with the board in view, found "
            f"{len(positions)}; take 15 to 25, turned and shifted in all directions"
        )
    X, z, covariance, residual = _solve(positions, C)
    sd = 1e3 * float(np.sqrt(np.trace(covariance[3:, 3:])))
    if not np.isfinite(sd) or sd > MAX_SD_MM:
        raise DegenerateData(
            f"these gripper positions leave the camera uncertain by {sd:.0f} mm; move the gripper "
            "in all three directions and turn it between the pictures"
        )
    held = np.zeros(len(positions))
    for out in folds(len(positions), 5):
        train = np.setdiff1d(np.arange(len(positions)), out)
        part, w, _, _ = _solve(positions[train], C[train])
        held[out] = 1e3 * np.linalg.norm(_predicted(part, C[out], w) - positions[out], axis=1)
    say = [
        "solved from gripper positions only; poses with rotations give a several times better "
        "result"
    ]
    return PointFit(X, z, covariance, 1e3 * residual, held, tuple(say))


def _solve(p: Float, C: Float) -> tuple[Float, Float, Float, Float]:
    X, z = _start(p, C)

    def residual(step: Float) -> Float:
        moved = rigid.stepped(X, step[:6])
        return np.asarray((_predicted(moved, C, z + step[6:]) - p).ravel())

    scale = float(np.median(np.linalg.norm(_predicted(X, C, z) - p, axis=1))) + 1e-6
    best = least_squares(residual, np.zeros(9), loss="soft_l1", f_scale=3.0 * scale, x_scale="jac")
    plain = np.asarray(residual(best.x))
    variance = float((np.minimum(np.abs(plain), 5 * scale) ** 2).sum()) / max(plain.size - 9, 1)
    covariance = variance * np.asarray(np.linalg.pinv(best.jac.T @ best.jac), float)
    result = rigid.stepped(X, best.x[:6])
    return (
        result,
        z + best.x[6:],
        covariance[:6, :6],
        np.asarray(np.linalg.norm(plain.reshape(-1, 3), axis=1)),
    )


def _start(p: Float, C: Float) -> tuple[Float, Float]:
    """Point and pose in turn: each is a closed form given the other (Kabsch 1976)."""
    z, X = np.zeros(3), np.eye(4)
    for _ in range(60):
        seen = C[:, :3, :3] @ z + C[:, :3, 3]
        a, b = seen - seen.mean(axis=0), p - p.mean(axis=0)
        R = nearest_rotation(b.T @ a)
        X = transform(R, p.mean(axis=0) - R @ seen.mean(axis=0))
        M = (R @ C[:, :3, :3]).reshape(-1, 3)
        right = p - C[:, :3, 3] @ R.T - X[:3, 3]
        z = np.asarray(np.linalg.lstsq(M, right.ravel(), rcond=None)[0], float)
    return X, z


def _predicted(X: Float, C: Float, z: Float) -> Float:
    return (C[:, :3, :3] @ z + C[:, :3, 3]) @ X[:3, :3].T + X[:3, 3]
