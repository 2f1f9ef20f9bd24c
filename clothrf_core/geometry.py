"""Rigid transforms, as small pure functions. `T_ab` maps b to a: ``x_a = T_ab @ x_b``."""

from __future__ import annotations

import numpy as np

from clothrf_core.types import Float


def transform(rotation: Float, translation: Float) -> Float:
    """(4, 4) transform of a (3, 3) rotation and a (3,) translation."""
    T = np.eye(4)
    T[:3, :3] = rotation
    T[:3, 3] = translation
    return T


def inverse(T_ab: Float) -> Float:
    """(4, 4) T_ba of a rigid (4, 4) T_ab."""
    R = T_ab[:3, :3]
    return transform(R.T, -R.T @ T_ab[:3, 3])


def apply(T_ab: Float, points: Float) -> Float:
    """(..., 3) points of frame b, in frame a."""
    result: Float = points @ T_ab[:3, :3].T + T_ab[:3, 3]
    return result


def rotation_vector(vector: Float) -> Float:
    """(3, 3) rotation about a (3,) axis times angle, radians (Rodrigues' formula)."""
    angle = float(np.linalg.norm(vector))
    if angle < 1e-12:
        return np.eye(3) + skew(vector)
    K = skew(np.asarray(vector) / angle)
    R: Float = np.eye(3) + np.sin(angle) * K + (1.0 - np.cos(angle)) * (K @ K)
    return R


def skew(v: Float) -> Float:
    """(3, 3) matrix with ``skew(v) @ w == cross(v, w)``."""
    return np.array([[0.0, -v[2], v[1]], [v[2], 0.0, -v[0]], [-v[1], v[0], 0.0]])


def nearest_rotation(matrix: Float) -> Float:
    """(3, 3) rotation closest to `matrix` in the Frobenius norm (Higham 1986, by SVD)."""
    U, _, Vt = np.linalg.svd(matrix)
    result: Float = U @ np.diag([1.0, 1.0, np.linalg.det(U @ Vt)]) @ Vt
    return result


def rotation_angle(R: Float) -> float:
    """Angle of a (3, 3) rotation in [0, pi] radians, accurate near 0 and pi."""
    axis = np.array([R[2, 1] - R[1, 2], R[0, 2] - R[2, 0], R[1, 0] - R[0, 1]])
    return float(np.arctan2(np.linalg.norm(axis), np.trace(R) - 1.0))


def look_at(eye: Float, target: Float, *, up: tuple[float, float, float] = (0, 0, 1)) -> Float:
    """(4, 4) T_world_camera of an OpenCV camera at `eye` (3,) looking at `target` (3,)."""
    z = np.asarray(target, float) - eye
    z /= np.linalg.norm(z)
    x = np.cross(z, np.asarray(up, float))
    if np.linalg.norm(x) < 1e-9:
        x = np.cross(z, [1.0, 0.0, 0.0])
    x /= np.linalg.norm(x)
    return transform(np.stack([x, np.cross(z, x), z], axis=1), np.asarray(eye, float))
