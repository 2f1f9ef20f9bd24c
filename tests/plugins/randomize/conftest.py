from __future__ import annotations

import dataclasses

import numpy as np
import pytest

from clothrf_core.geometry import look_at
from clothrf_core.params import Randomization, SimulationParams
from clothrf_core.types import CameraModel, RgbdFrame


@pytest.fixture
def camera():
    return CameraModel(
        width=640,
        height=480,
        K=np.array([[620.0, 0, 319.5], [0, 620, 239.5], [0, 0, 1]]),
        T_world_camera=look_at(np.array([0.80, 0.0, 0.65]), np.array([0.55, 0.0, 0.35])),
    )


@pytest.fixture
def nominal(camera):
    hands = np.array([[0.655, -0.14, 0.279], [0.62, 0.14, 0.309]])
    grasp = np.array([[0.40, -0.14, 0.43], [0.39, 0.14, 0.44]])
    return Randomization(simulation=SimulationParams(hands=hands, grasp=grasp), camera=camera)


@pytest.fixture
def flat(camera):
    """A plate at right angles to the optical axis, 0.5 m away, with nothing around it."""
    depth = np.full((480, 640), np.nan, np.float32)
    depth[90:390, 120:520] = 0.5
    return RgbdFrame(
        stamp_ns=7, rgb=np.full((480, 640, 3), 90, np.uint8), depth=depth, camera=camera
    )


@pytest.fixture
def small(camera):
    """A wavy, torn, stepped sheet on 60 x 84 pixels that touches the border of the picture."""
    v, u = np.mgrid[0:60, 0:84].astype(float)
    depth = (0.5 + 0.004 * np.sin(u / 6) + 0.0012 * v).astype(np.float32)
    depth[20:40, 50:70] -= 0.08
    depth[:12] = np.nan
    depth[abs(v - 45) + abs(u - 20) < 5] = np.nan
    depth[:, 78:] = np.nan
    depth[33, 33] = np.nan
    lens = dataclasses.replace(
        camera, width=84, height=60, K=np.array([[90.0, 0, 41], [0, 95, 30], [0, 0, 1]])
    )
    return RgbdFrame(stamp_ns=1, rgb=np.zeros((60, 84, 3), np.uint8), depth=depth, camera=lens)
