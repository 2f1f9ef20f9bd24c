"""How long SAPIEN takes for a picture, and how far the CPU renderer's picture is from it."""

from __future__ import annotations

import time

import numpy as np

from clothrf_core.provider import Figure
from clothrf_core.registry import Registry
from clothrf_core.testing.camera import differences
from clothrf_core.testing.pictures import measure, standard_camera, standard_scenes
from clothrf_sapien.camera import SapienCamera
from clothrf_sapien.camera_config import SapienCameraConfig
from clothrf_sapien.vulkan import probe


def frames(*, quick: bool) -> list[Figure]:
    """Wall time of 640 x 480 colour, depth and labels, the cloth rebuilt in every frame.

    Needs a Vulkan driver and the extra `sapien`. The peer is the camera `raster` if installed; its
    greatest depth difference away from edges is the second figure.
    """
    report = probe()
    scenes, model = standard_scenes(16), standard_camera()
    count = 40 if quick else 200
    with SapienCamera(SapienCameraConfig()) as camera:
        start = time.perf_counter_ns()
        camera.render(scenes[0], model)
        first = (time.perf_counter_ns() - start) * 1e-6
        wall = measure(lambda i: camera.render(scenes[i % 16], model), count, time.perf_counter_ns)
        cpu = measure(lambda i: camera.render(scenes[i % 16], model), count, time.process_time_ns)
        detail = {
            "p99_ms": wall.p99,
            "first_frame_ms": first,
            "process_cpu_ms": cpu.median,
            "device": report.device,
        }
        figures = [Figure("sapien_frame_ms", wall.median, "ms", detail)]
        registry = Registry.installed()
        if "raster" in registry.names("camera"):
            other = registry.build("camera", "raster")
            compared = [
                differences(camera.render(scene, model), other.render(scene, model))
                for scene in (scenes[:4] if quick else scenes)
            ]
            depth = np.concatenate([delta for delta, _ in compared])
            labels = max(share for _, share in compared)
            figures.append(
                Figure(
                    "raster_vs_sapien_mm",
                    1e3 * float(depth.max()),
                    "mm",
                    {
                        "median_mm": 1e3 * float(np.median(depth)),
                        "pixels": len(depth),
                        "label_share_away_from_edges": labels,
                    },
                )
            )
    return figures
