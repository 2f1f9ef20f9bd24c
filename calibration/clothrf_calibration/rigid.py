"""Many rigid motions at once: rotation vectors, their matrices, small left steps."""

from __future__ import annotations

import numpy as np

from clothrf_core.types import Float


def exp(vectors: Float) -> Float:
    """(..., 3, 3) rotations of (..., 3) rotation vectors (Rodrigues), exact near zero."""
    angle = np.linalg.norm(vectors, axis=-1)[..., None, None]
    K = skew(vectors)
    small = angle < 1e-6
    safe = np.where(small, 1.0, angle)
    a = np.where(small, 1.0 - angle**2 / 6.0, np.sin(safe) / safe)
    b = np.where(small, 0.5 - angle**2 / 24.0, (1.0 - np.cos(safe)) / safe**2)
    R: Float = np.eye(3) + a * K + b * (K @ K)
    return R


def log(R: Float) -> Float:
    """(..., 3) rotation vectors of (..., 3, 3) rotations, angle in [0, pi]."""
    flat = R.reshape(-1, 3, 3)
    out = np.empty((len(flat), 3))
    for n, r in enumerate(flat):
        axis = np.array([r[2, 1] - r[1, 2], r[0, 2] - r[2, 0], r[1, 0] - r[0, 1]])
        sine, cosine = 0.5 * np.linalg.norm(axis), 0.5 * (np.trace(r) - 1.0)
        angle = np.arctan2(sine, cosine)
        if sine > 1e-7:
            out[n] = 0.5 * axis * angle / sine
        elif cosine > 0.0:
            out[n] = 0.5 * axis
        else:
            values = np.sqrt(np.maximum(0.5 * (np.diag(r) + 1.0), 0.0))
            k = int(np.argmax(values))
            signs = np.sign(r[k] + (np.arange(3) == k))
            signs[signs == 0] = 1.0
            out[n] = angle * values * signs
    return out.reshape(*R.shape[:-2], 3)


def skew(v: Float) -> Float:
    """(..., 3, 3) matrices with ``skew(v) @ w == cross(v, w)``."""
    S = np.zeros((*v.shape[:-1], 3, 3))
    S[..., 0, 1], S[..., 0, 2] = -v[..., 2], v[..., 1]
    S[..., 1, 0], S[..., 1, 2] = v[..., 2], -v[..., 0]
    S[..., 2, 0], S[..., 2, 1] = -v[..., 1], v[..., 0]
    return S


def inverse(T: Float) -> Float:
    """(..., 4, 4) inverses of rigid (..., 4, 4) transforms."""
    out = np.zeros_like(T)
    Rt = np.swapaxes(T[..., :3, :3], -1, -2)
    out[..., :3, :3] = Rt
    out[..., :3, 3] = -(Rt @ T[..., :3, 3, None])[..., 0]
    out[..., 3, 3] = 1.0
    return out


def stepped(T: Float, step: Float) -> Float:
    """(..., 4, 4) transforms after (..., 6) left steps ``R <- exp(w) R, t <- t + d``."""
    out = np.array(T)
    out[..., :3, :3] = exp(step[..., :3]) @ T[..., :3, :3]
    out[..., :3, 3] += step[..., 3:]
    return out


def angle_deg(R: Float) -> Float:
    """(...,) rotation angles in degrees of (..., 3, 3) rotations."""
    axis = np.stack(
        [R[..., 2, 1] - R[..., 1, 2], R[..., 0, 2] - R[..., 2, 0], R[..., 1, 0] - R[..., 0, 1]], -1
    )
    trace = R[..., 0, 0] + R[..., 1, 1] + R[..., 2, 2]
    return np.asarray(np.degrees(np.arctan2(np.linalg.norm(axis, axis=-1), trace - 1.0)))


def mean(T: Float) -> Float:
    """(4, 4) mean of (N, 4, 4) rigid transforms: chordal for the rotation (Hartley et al. 2013)."""
    U, _, Vt = np.linalg.svd(T[:, :3, :3].sum(axis=0))
    out = np.eye(4)
    out[:3, :3] = U @ np.diag([1.0, 1.0, np.linalg.det(U @ Vt)]) @ Vt
    out[:3, 3] = T[:, :3, 3].mean(axis=0)
    return out
