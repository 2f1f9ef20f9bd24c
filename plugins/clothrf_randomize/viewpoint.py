"""Where the camera really is, if its calibration is a little wrong."""

from __future__ import annotations

import dataclasses

import numpy as np

from clothrf_core.geometry import rotation_vector
from clothrf_core.types import CameraModel
from clothrf_randomize.config import CameraSpread


def vary_camera(
    rng: np.random.Generator, nominal: CameraModel, spread: CameraSpread
) -> CameraModel:
    """A camera beside the nominal one; all errors are uniform and independent.

    Position errors are along the world's axes, rotation errors about the camera's own axes.
    """
    if spread.strength == 0.0:
        return nominal
    s = spread.strength
    turn = rotation_vector(s * np.radians(spread.rotation_deg) * rng.uniform(-1.0, 1.0, 3))
    T = np.array(nominal.T_world_camera)
    T[:3, :3] = T[:3, :3] @ turn
    T[:3, 3] += s * spread.position * rng.uniform(-1.0, 1.0, 3)
    K = np.array(nominal.K)
    K[0, 0] *= 1.0 + s * spread.focal * rng.uniform(-1.0, 1.0)
    K[1, 1] *= 1.0 + s * spread.focal * rng.uniform(-1.0, 1.0)
    K[:2, 2] += s * spread.centre_px * rng.uniform(-1.0, 1.0, 2)
    return dataclasses.replace(nominal, K=K, T_world_camera=T)
