"""Time from a 640 x 480 picture to its numbers, beside what one would write with OpenCV alone."""

from __future__ import annotations

import time
from collections.abc import Callable

import cv2
import numpy as np

from clothrf_core.provider import Figure
from clothrf_core.rig import CameraSection, ForegroundSection, GraspSection, HandsSection, Rig
from clothrf_core.testing.features import draw_sheet
from clothrf_core.types import GraspState, Observation, RgbdFrame
from clothrf_how.config import FeatureOptions, HowOptions
from clothrf_how.extractor import Extractor
from clothrf_how.foreground import Foreground
from clothrf_how.gabor import bank
from clothrf_how.how import relief


def features(*, quick: bool) -> list[Figure]:
    """`features_ms`: median CPU time of picture -> 768 numbers on one core."""
    rig = bench_rig()
    frame = _wrinkled(draw_sheet(rig))
    observation = Observation(frame, GraspState(rig.rest_grasp, 0))
    only = Extractor(FeatureOptions(groups=("how",)), rig)
    default = Extractor(FeatureOptions(), rig)
    area = only.foreground(frame)
    rounds = 40 if quick else 400

    threads = cv2.getNumThreads()
    cv2.setNumThreads(1)
    try:
        ours = _times(lambda: only.extract(observation), rounds)
        whole = _times(lambda: default.extract(observation), rounds)
        found = _times(lambda: only.foreground(frame), rounds)
        peer = _times(lambda: _plain_bank(area), max(10, rounds // 10))
    finally:
        cv2.setNumThreads(threads)

    median = float(np.median(ours))
    return [
        Figure(
            "features_ms",
            median,
            "ms",
            {
                "p99": float(np.percentile(ours, 99)),
                "foreground": float(np.median(found)),
                "all_default_groups": float(np.median(whole)),
                "all_default_groups_p99": float(np.percentile(whole, 99)),
                "cv2_filter2d_bank": float(np.median(peer)),
                "ratio_cv2_filter2d_bank": float(np.median(peer)) / median,
                "foreground_share": area.area / area.mask.size,
            },
        )
    ]


def bench_rig() -> Rig:
    """A camera half a metre from a cloth that fills a third of its picture."""
    pose = np.array([[0, 0.8, -0.6, 0.8], [1, 0, 0, 0], [0, -0.6, -0.8, 0.75], [0, 0, 0, 1]])
    return Rig(
        name="bench",
        camera=CameraSection(
            K=[[620.0, 0.0, 320.0], [0.0, 620.0, 240.0], [0.0, 0.0, 1.0]],
            T_world_camera=pose.tolist(),
        ),
        hands=HandsSection(rest=[[0.6, -0.15, 0.25], [0.6, 0.15, 0.25]]),
        grasp=GraspSection(rest=[[0.35, -0.15, 0.35], [0.35, 0.15, 0.35]]),
        foreground=ForegroundSection(low=[0.0, -0.5, 0.0], high=[1.0, 0.5, 0.8]),
    )


def _wrinkled(frame: RgbdFrame) -> RgbdFrame:
    """Waves of 2 mm, SR300 noise and drop-outs (1.3e-3 z^2; 1 %), and a background at 1.1 m."""
    rng = np.random.default_rng(0)
    h, w = frame.depth.shape
    y, x = np.mgrid[:h, :w]
    depth = frame.depth + 2e-3 * np.sin(x / 8.0 + y / 30.0)
    depth = np.where(np.isnan(depth), 1.1, depth)
    depth = depth + rng.normal(size=(h, w)) * 1.3e-3 * depth**2
    depth[rng.random((h, w)) < 0.01] = np.nan
    return RgbdFrame(stamp_ns=0, rgb=frame.rgb, depth=depth.astype(np.float32), camera=frame.camera)


def _plain_bank(area: Foreground) -> None:
    """The peer: four `cv2.filter2D` calls at 320 x 240 and block sums, foreground given."""
    options = HowOptions()
    picture = relief(area, "plane")
    mask = area.mask.astype(np.float32)
    for kernel in bank(options, orientations=4, wavelength=options.wavelength, psi=0.0):
        answer = cv2.filter2D(src=picture, ddepth=cv2.CV_32F, kernel=kernel)
        answer = np.maximum(answer, 0.0) * mask
        answer.reshape(12, 20, 16, 20).sum(axis=(1, 3))


def _times(call: Callable[[], object], rounds: int) -> list[float]:
    """CPU time of this thread in milliseconds, call by call, after a warm-up."""
    for _ in range(3):
        call()
    times = []
    for _ in range(rounds):
        start = time.thread_time_ns()
        call()
        times.append((time.thread_time_ns() - start) / 1e6)
    return times
