"""A standard scene for benchmarks and comparisons of renderers: cloth, hands, grippers, table."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass

import numpy as np

from clothrf_core.geometry import look_at
from clothrf_core.scene import Label, Scene, SceneMesh, box, capsule
from clothrf_core.types import CameraModel


@dataclass(frozen=True, slots=True)
class Times:
    """Milliseconds."""

    median: float
    p99: float


def measure(work: Callable[[int], object], count: int, clock: Callable[[], int]) -> Times:
    """Time of `work(i)` for i = 0, 1, ..., by a nanosecond `clock`, after three warm-up calls."""
    for i in range(3):
        work(i)
    spent = np.empty(count)
    for i in range(count):
        start = clock()
        work(i)
        spent[i] = (clock() - start) * 1e-6
    return Times(float(np.median(spent)), float(np.percentile(spent, 99)))


def standard_camera() -> CameraModel:
    """640 x 480 pixels at 0.4 to 0.8 m from the cloth, as in the paper's set-up."""
    return CameraModel(
        width=640,
        height=480,
        K=np.array([[620.0, 0.0, 311.6], [0.0, 620.0, 251.4], [0.0, 0.0, 1.0]]),
        T_world_camera=look_at(np.array([0.80, -0.01, 0.65]), np.array([0.52, 0.0, 0.30])),
        near=0.1,
        far=1.6,
    )


def standard_scenes(count: int) -> list[Scene]:
    """A 21 x 24 sheet that sways between two hands and two grippers over a table."""
    table = box(np.array([0.0, -0.6, -0.04]), np.array([1.1, 0.6, -0.02]), Label.TABLE, (0.4,) * 3)
    corners = np.array(
        [[0.655, -0.15, 0.279], [0.609, 0.15, 0.309], [0.492, -0.15, 0.475], [0.489, 0.15, 0.479]]
    )
    u, v = np.meshgrid(np.linspace(0, 1, 21), np.linspace(0, 1, 24), indexing="ij")
    i, j = np.meshgrid(np.arange(20), np.arange(23), indexing="ij")
    a = (24 * i + j).ravel()
    triangles = np.concatenate(
        [np.stack([a, a + 1, a + 24], 1), np.stack([a + 1, a + 25, a + 24], 1)]
    ).astype(np.int32)
    scenes = []
    for k in range(count):
        sway = 0.01 * np.sin(2 * np.pi * k / count)
        weights = np.stack([(1 - u) * (1 - v), u * (1 - v), (1 - u) * v, u * v], axis=-1)
        points = weights @ corners
        points[..., 2] -= 0.05 * np.sin(np.pi * u) + 0.03 * np.sin(np.pi * v)
        points[..., 0] += sway * np.sin(3 * np.pi * u) * np.sin(np.pi * v)
        cloth = SceneMesh(Label.CLOTH, points.reshape(-1, 3), triangles, (0.1, 0.45, 0.5))
        hands = [
            capsule(p, p + np.array([0.1, 0.0, -0.02]), 0.022, Label.HAND, (0.6, 0.4, 0.3))
            for p in corners[:2]
        ]
        grippers = [
            capsule(p, p + np.array([-0.1, 0.0, 0.1]), 0.014, Label.GRIPPER, (0.4, 0.4, 0.4))
            for p in corners[2:]
        ]
        scenes.append(Scene(meshes=(cloth, *hands, *grippers, table), stamp_ns=k))
    return scenes
