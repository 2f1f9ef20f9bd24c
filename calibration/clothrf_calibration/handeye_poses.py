"""Hand-eye from pairs of poses alone: for board poses that some other program measured.

Pose residuals are weighed by their own spread, estimated along the way, and by Cauchy weights.
With pictures at hand use `handeye`: corners say much more than poses.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from clothrf_calibration import rigid
from clothrf_calibration.crossvalidation import folds
from clothrf_calibration.handeye_fit import covariance_of_inverse
from clothrf_calibration.handeye_start import shah
from clothrf_core.types import Float

CAUCHY = 2.4


@dataclass(frozen=True, slots=True, eq=False)
class PoseFit:
    """X and Z from pose pairs.

    Attributes:
        X: (4, 4) see `handeye_start`.
        Z: (4, 4) see `handeye_start`.
        X_covariance: (6, 6) left turn (rad) then shift (m).
        turn: (V,) residual rotations, degrees.
        shift: (V,) residual positions, millimetres.
        weights: (V,) in (0, 1]; small = an outlier.
    """

    X: Float
    Z: Float
    X_covariance: Float
    turn: Float
    shift: Float
    weights: Float


def fit_poses(A: Float, C: Float, *, start: tuple[Float, Float] | None = None) -> PoseFit:
    """Refine X and Z on (V, 4, 4) pose pairs by weighted least squares on the pose residuals."""
    X, Z = start or shah(A, C)
    Y = rigid.inverse(X)
    weights = np.ones(len(A))
    information = np.eye(12)
    for _ in range(40):
        residual, J = _linear(Y, Z, A, C)
        s_turn = _spread(residual[:, :3], weights)
        s_shift = _spread(residual[:, 3:], weights)
        scale = 1.0 / np.array([s_turn] * 3 + [s_shift] * 3)
        normal = np.linalg.norm(residual * scale, axis=1) / np.sqrt(6.0)
        weights = 1.0 / (1.0 + (normal / CAUCHY) ** 2)
        root = np.sqrt(weights)[:, None] * scale
        r, W = (residual * root).ravel(), (J * root[:, :, None]).reshape(-1, 12)
        information = W.T @ W
        step = -np.linalg.lstsq(W, r, rcond=1e-12)[0]
        Y, Z = rigid.stepped(Y, step[:6]), rigid.stepped(Z, step[6:])
        if float(np.abs(step).max()) < 1e-12:
            break
    residual, _ = _linear(Y, Z, A, C)
    used = float(weights.sum())
    covariance: Float = np.asarray(np.linalg.pinv(information)) * 6 * used / max(6 * used - 12, 1.0)
    return PoseFit(
        rigid.inverse(Y),
        Z,
        covariance_of_inverse(Y, covariance[:6, :6]),
        np.degrees(np.linalg.norm(residual[:, :3], axis=1)),
        1e3 * np.linalg.norm(residual[:, 3:], axis=1),
        weights,
    )


def held_out_poses(A: Float, C: Float, *, k: int = 5) -> tuple[Float, Float]:
    """(V,) mm and (V,) degrees between seen and predicted board poses, by k folds."""
    shift, turn = np.zeros(len(A)), np.zeros(len(A))
    for held in folds(len(A), k):
        train = np.setdiff1d(np.arange(len(A)), held)
        result = fit_poses(A[train], C[train])
        predicted = rigid.inverse(result.X) @ A[held] @ result.Z
        shift[held] = 1e3 * np.linalg.norm(predicted[:, :3, 3] - C[held][:, :3, 3], axis=1)
        apart = predicted[:, :3, :3] @ np.swapaxes(C[held][:, :3, :3], 1, 2)
        turn[held] = rigid.angle_deg(apart)
    return shift, turn


def _linear(Y: Float, Z: Float, A: Float, C: Float) -> tuple[Float, Float]:
    """(V, 6) residuals and (V, 6, 12) derivatives by left steps of Y and Z."""
    R_YA = Y[:3, :3] @ A[:, :3, :3]
    turned = (R_YA @ Z[:3, 3]) + A[:, :3, 3] @ Y[:3, :3].T
    residual = np.empty((len(A), 6))
    residual[:, :3] = rigid.log(R_YA @ Z[:3, :3] @ np.swapaxes(C[:, :3, :3], 1, 2))
    residual[:, 3:] = turned + Y[:3, 3] - C[:, :3, 3]
    J = np.zeros((len(A), 6, 12))
    J[:, :3, :3] = np.eye(3)
    J[:, :3, 6:9] = R_YA
    J[:, 3:, :3] = -rigid.skew(turned)
    J[:, 3:, 3:6] = np.eye(3)
    J[:, 3:, 9:] = R_YA
    return residual, J


def _spread(residual: Float, weights: Float) -> float:
    """One standard deviation; a few wild residuals do not widen it (median of a chi, 3 dof)."""
    mean = float((weights * (residual**2).mean(axis=1)).sum() / weights.sum())
    median = float(np.median(np.linalg.norm(residual, axis=1))) / 1.538
    return max(min(float(np.sqrt(mean)), 1.5 * median), 1e-9)
