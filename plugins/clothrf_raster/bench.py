"""How long a picture takes, beside OpenCV's painter's drawing in the same run."""

from __future__ import annotations

import time
from collections.abc import Callable

import numpy as np
from numpy.typing import NDArray

from clothrf_core.provider import Figure
from clothrf_core.scene import Scene
from clothrf_core.testing.pictures import measure, standard_camera, standard_scenes
from clothrf_core.types import CameraModel
from clothrf_raster.bend import Bend
from clothrf_raster.camera import RasterCamera
from clothrf_raster.config import RasterConfig
from clothrf_raster.view import View


def frame(*, quick: bool) -> list[Figure]:
    """Thread CPU time of 640 x 480 depth and labels of cloth, hands and table.

    The cloth moves in every frame; the figure is the median, p99 and peers stand in the detail.
    """
    count = 60 if quick else 400
    scenes, camera = standard_scenes(16), standard_camera()
    plain_depth = RasterCamera(RasterConfig(colour=False))
    coloured = RasterCamera(RasterConfig(colour=True))
    numpy_engine = RasterCamera(RasterConfig(colour=False, engine="numpy"))
    fast = measure(lambda i: plain_depth.render(scenes[i % 16], camera), count, time.thread_time_ns)
    shaded = measure(
        lambda i: coloured.render(scenes[i % 16], camera), count // 2, time.thread_time_ns
    )
    plain = measure(
        lambda i: numpy_engine.render(scenes[i % 16], camera),
        6 if quick else 20,
        time.thread_time_ns,
    )
    detail = {
        "p99_ms": fast.p99,
        "with_colour_ms": shaded.median,
        "numpy_engine_ms": plain.median,
        "triangles": sum(len(mesh.triangles) for mesh in scenes[0].meshes),
    }
    painter = _painter(scenes[0], camera)
    if painter is not None:
        opencv = measure(lambda _: painter(), 6 if quick else 20, time.thread_time_ns)
        detail["opencv_fillConvexPoly_ms"] = opencv.median
        detail["opencv_over_raster"] = opencv.median / fast.median
    return [Figure("raster_frame_ms", fast.median, "ms", detail)]


def _painter(scene: Scene, camera: CameraModel) -> Callable[[], NDArray[np.float32]] | None:
    """Triangles filled from far to near at their mean depth: wrong where large meets small."""
    try:
        import cv2
    except ImportError:
        return None
    view = View.of(camera, Bend.none())

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
