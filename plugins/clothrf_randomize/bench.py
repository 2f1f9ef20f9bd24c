"""How long one disturbed frame takes."""

from __future__ import annotations

import time
from typing import get_args

import numpy as np

from clothrf_core.geometry import look_at
from clothrf_core.provider import Figure
from clothrf_core.types import CameraModel, RgbdFrame
from clothrf_randomize.config import Family, SensorNoise
from clothrf_randomize.sensor import Sensor


def corrupt_figures(*, quick: bool) -> list[Figure]:
    """CPU milliseconds a 640 x 480 frame: sheet over nothing, and a picture measured everywhere."""
    rounds = 20 if quick else 100
    figures = []
    for family in get_args(Family):
        sensor = Sensor(SensorNoise(family=family, episode="fixed"))
        sheet = _milliseconds(sensor, sheet_frame(), rounds)
        full = _milliseconds(sensor, sheet_frame(backdrop=0.9), rounds)
        figures.append(
            Figure(
                f"sensor_noise_{family}_ms",
                float(np.median(sheet)),
                "ms",
                {
                    "p99": float(np.quantile(sheet, 0.99)),
                    "every_pixel_measured": float(np.median(full)),
                },
            )
        )
    return figures


def sheet_frame(*, backdrop: float = float("nan")) -> RgbdFrame:
    """A wavy sheet 0.5 m away over a quarter of 640 x 480 pixels; `backdrop` m behind it."""
    camera = CameraModel(
        width=640,
        height=480,
        K=np.array([[620.0, 0, 319.5], [0, 620, 239.5], [0, 0, 1]]),
        T_world_camera=look_at(np.array([0.8, 0.0, 0.65]), np.array([0.55, 0.0, 0.35])),
    )
    v, u = np.mgrid[0:480, 0:640].astype(float)
    z = 0.5 + 0.1 * (v - 240) / 480 + 0.004 * np.sin(u / 25.0)
    inside = (abs(u - 320 - 20 * np.sin(v / 60)) < 150) & (abs(v - 240) < 130)
    depth = np.where(inside, z, backdrop).astype(np.float32)
    return RgbdFrame(stamp_ns=0, rgb=np.zeros((480, 640, 3), np.uint8), depth=depth, camera=camera)


def _milliseconds(sensor: Sensor, frame: RgbdFrame, rounds: int) -> list[float]:
    rng = np.random.default_rng(0)
    numbers = sensor.draw(rng)
    sensor.apply(frame, numbers, rng)
    spent = []
    for _ in range(rounds):
        start = time.thread_time_ns()
        sensor.apply(frame, numbers, rng)
        spent.append((time.thread_time_ns() - start) / 1e6)
    return spent
