"""Closed-form hand-eye solutions: start values for the joint refinement.

All of them solve ``X C_i = A_i Z`` for X and Z. With the camera fixed and the board on the gripper,
A = T_base_gripper, X = T_base_camera, Z = T_gripper_board; with the camera on the hand and the
board fixed, A = T_gripper_base, X = T_gripper_camera, Z = T_base_board; C = T_camera_board always.
"""

from __future__ import annotations

from collections.abc import Callable, Mapping

import cv2
import numpy as np

from clothrf_calibration import rigid
from clothrf_core.geometry import nearest_rotation, transform
from clothrf_core.types import Float


def park(A: Float, C: Float) -> tuple[Float, Float]:
    """X and Z by AX = XB on all pairs of views (Park and Martin 1994).

    Args:
        A: (V, 4, 4).
        C: (V, 4, 4) T_camera_board.
    """
    i, j = np.triu_indices(len(A), 1)
    moved, seen = A[i] @ rigid.inverse(A[j]), C[i] @ rigid.inverse(C[j])
    alpha, beta = rigid.log(moved[:, :3, :3]), rigid.log(seen[:, :3, :3])
    R = nearest_rotation(alpha.T @ beta)
    M = (moved[:, :3, :3] - np.eye(3)).reshape(-1, 3)
    right = (seen[:, :3, 3] @ R.T - moved[:, :3, 3]).ravel()
    t: Float = np.asarray(np.linalg.lstsq(M, right, rcond=None)[0], float)
    X = transform(R, t)
    return X, board_of(A, C, X)


def shah(A: Float, C: Float) -> tuple[Float, Float]:
    """X and Z together by the Kronecker product (Shah 2013)."""
    K = np.zeros((9, 9))
    for a, c in zip(A[:, :3, :3], C[:, :3, :3], strict=True):
        K += np.kron(c.T, a.T)
    U, _, Vt = np.linalg.svd(K)
    X_raw, Z_raw = Vt[0].reshape(3, 3).T, U[:, 0].reshape(3, 3).T
    sign = np.sign(np.linalg.det(X_raw)) or 1.0
    R_X, R_Z = nearest_rotation(sign * X_raw), nearest_rotation(sign * Z_raw)
    M = np.concatenate([np.tile(-np.eye(3), (len(A), 1, 1)), A[:, :3, :3]], axis=2).reshape(-1, 6)
    right = (C[:, :3, 3] @ R_X.T - A[:, :3, 3]).ravel()
    t = np.linalg.lstsq(M, right, rcond=None)[0]
    return transform(R_X, t[:3]), transform(R_Z, t[3:])


def board_of(A: Float, C: Float, X: Float) -> Float:
    """(4, 4) Z that fits best to a given X: the mean of ``inv(A_i) X C_i``."""
    return rigid.mean(rigid.inverse(A) @ X @ C)


def _opencv(method: int) -> Callable[[Float, Float], tuple[Float, Float]]:
    def run(A: Float, C: Float) -> tuple[Float, Float]:
        G = rigid.inverse(A)
        # By position, `method` would land in an output argument and silently run Tsai.
        R, t = cv2.calibrateHandEye(
            R_gripper2base=list(G[:, :3, :3]),
            t_gripper2base=list(G[:, :3, 3]),
            R_target2cam=list(C[:, :3, :3]),
            t_target2cam=list(C[:, :3, 3]),
            method=method,
        )
        X = transform(np.asarray(R, float), np.ravel(t))
        return X, board_of(A, C, X)

    return run


def methods() -> Mapping[str, Callable[[Float, Float], tuple[Float, Float]]]:
    """Name -> solver: our own, and OpenCV's where this OpenCV has them (5.0.0 has none)."""
    found: dict[str, Callable[[Float, Float], tuple[Float, Float]]] = {"park": park, "shah": shah}
    if hasattr(cv2, "calibrateHandEye"):
        for name in ("TSAI", "HORAUD", "ANDREFF", "DANIILIDIS", "PARK"):
            found[f"cv2 {name.lower()}"] = _opencv(getattr(cv2, f"CALIB_HAND_EYE_{name}"))
    return found


def starts(A: Float, C: Float) -> dict[str, tuple[Float, Float]]:
    """Method -> (X, Z), of those that gave finite rotations."""
    result = {}
    for name, solver in methods().items():
        try:
            X, Z = solver(A, C)
        except (cv2.error, np.linalg.LinAlgError):
            continue
        good = all(
            np.isfinite(T).all() and np.allclose(T[:3, :3] @ T[:3, :3].T, np.eye(3), atol=1e-6)
            for T in (X, Z)
        )
        if good:
            result[name] = (X, Z)
    return result
