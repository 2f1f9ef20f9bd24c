"""How long a picture takes, beside OpenCV's painter's drawing in the same run."""

from __future__ import annotations

import time
from collections.abc import Callable
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from clothrf_core.geometry import look_at
from clothrf_core.provider import Figure
from clothrf_core.scene import Label, Scene, SceneMesh, box, capsule
from clothrf_core.types import CameraModel
from clothrf_raster.camera import RasterCamera
from clothrf_raster.config import RasterConfig
from clothrf_raster.view import View


def frame(*, quick: bool) -> list[Figure]:
    """Thread CPU time of 640 x 480 depth and labels of cloth, hands and table.

    The cloth moves in every frame; the figure is the median, p99 and peers stand in the detail.
    """
    count = 60 if quick else 400
    scenes, camera = _scenes(16), _camera()
    plain_depth = RasterCamera(RasterConfig(colour=False))
    coloured = RasterCamera(RasterConfig(colour=True))
    numpy_engine = RasterCamera(RasterConfig(colour=False, engine="numpy"))
    fast = _measure(lambda i: plain_depth.render(scenes[i % 16], camera), count)
    shaded = _measure(lambda i: coloured.render(scenes[i % 16], camera), count // 2)
    plain = _measure(lambda i: numpy_engine.render(scenes[i % 16], camera), 6 if quick else 20)
    detail = {
        "p99_ms": fast.p99,
        "with_colour_ms": shaded.median,
        "numpy_engine_ms": plain.median,
        "triangles": sum(len(mesh.triangles) for mesh in scenes[0].meshes),
    }
    painter = _painter(scenes[0], camera)
    if painter is not None:
        opencv = _measure(lambda _: painter(), 6 if quick else 20)
        detail["opencv_fillConvexPoly_ms"] = opencv.median
        detail["opencv_over_raster"] = opencv.median / fast.median
    return [Figure("raster_frame_ms", fast.median, "ms", detail)]


@dataclass(frozen=True, slots=True)
class Times:
    """Milliseconds of thread CPU time."""

    median: float
    p99: float


def _measure(work: Callable[[int], object], count: int) -> Times:
    for i in range(3):
        work(i)
    spent = np.empty(count)
    for i in range(count):
        start = time.thread_time_ns()
        work(i)
        spent[i] = (time.thread_time_ns() - start) * 1e-6
    return Times(float(np.median(spent)), float(np.percentile(spent, 99)))


def _camera() -> CameraModel:
    return CameraModel(
        width=640,
        height=480,
        K=np.array([[620.0, 0.0, 311.6], [0.0, 620.0, 251.4], [0.0, 0.0, 1.0]]),
        T_world_camera=look_at(np.array([0.80, -0.01, 0.65]), np.array([0.52, 0.0, 0.30])),
        near=0.1,
        far=1.6,
    )


def _scenes(count: int) -> list[Scene]:
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


def _painter(scene: Scene, camera: CameraModel) -> Callable[[], NDArray[np.float32]] | None:
    """Triangles filled from far to near at their mean depth: wrong where large meets small."""
    try:
        import cv2
    except ImportError:
        return None
    view = View.of(camera)

    def paint() -> NDArray[np.float32]:
        depth = np.full((view.height, view.width), np.nan, np.float32)
        labels = np.zeros((view.height, view.width), np.uint8)
        faces, depths, names = [], [], []
        for mesh in scene.meshes:
            local = mesh.vertices @ view.pose[:, :3].T + view.pose[:, 3]
            fx, _, cx, fy, cy = view.lens
            pixel = np.stack(
                [fx * local[:, 0] / local[:, 2] + cx, fy * local[:, 1] / local[:, 2] + cy], 1
            )
            faces.append(np.rint(16.0 * pixel[mesh.triangles]).astype(np.int32))
            depths.append(local[:, 2][mesh.triangles].mean(axis=1))
            names.append(np.full(len(mesh.triangles), int(mesh.label)))
        corners, z, name = np.concatenate(faces), np.concatenate(depths), np.concatenate(names)
        for k in np.argsort(-z):
            cv2.fillConvexPoly(img=depth, points=corners[k], color=float(z[k]), shift=4)
            cv2.fillConvexPoly(img=labels, points=corners[k], color=int(name[k]), shift=4)
        return depth

    return paint
