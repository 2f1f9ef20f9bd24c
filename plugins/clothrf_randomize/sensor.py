"""A depth sensor's errors on one frame: strengths of a roll-out in, disturbed frame out.

Order: wobbling edges, noise along the ray, what slant adds, drop-outs, rounding, holes, and the
roll-out's bias and scale. Occluders are drawn, not painted.
"""

from __future__ import annotations

import dataclasses
from collections.abc import Mapping

import numpy as np
from numpy.typing import NDArray

from clothrf_core.types import Float32, RgbdFrame
from clothrf_randomize.axial import AxialStrengths, Lens, axial_noise
from clothrf_randomize.config import SensorNoise
from clothrf_randomize.disparity import DisparityStrengths, disparity_noise, dot_pattern
from clothrf_randomize.edges import Window, edge_distance2, measured_window
from clothrf_randomize.families import EDGE_DROP, axial_sensor, disparity_sensor
from clothrf_randomize.holes import draw_blobs, punch
from clothrf_randomize.pool import make_pool, starts
from clothrf_randomize.smooth import weights

# Neighbours farther apart than this lie on different surfaces, m.
JUMP = 0.015
# Nodes of the low-frequency noise, each way.
COARSE = 8

PARTS = ("jitter", "axial", "smooth", "incidence", "edges", "holes")


class Sensor:
    """The errors of one family of sensors, with its tables made once."""

    def __init__(self, config: SensorNoise) -> None:
        self.config = config
        self._pool = make_pool()
        self._edge_drop = np.array(EDGE_DROP)
        self._dots = dot_pattern()
        self._metric = config.family in ("sr300", "kinect", "d435")
        if self._metric:
            self._axial = axial_sensor(config.family, cosine_drop=config.cosine_drop)
        else:
            self._disparity = disparity_sensor(config.family)

    def draw(self, rng: np.random.Generator) -> Mapping[str, float]:
        """Strength of every part for one roll-out, its bias (m) and scale error (share)."""
        config = self.config
        numbers = {}
        for part in PARTS:
            spread = rng.uniform(0.0, 2.0) if config.episode == "uniform" else 1.0
            numbers[part] = config.strength * getattr(config, part) * spread
        offset = config.strength * config.offset
        numbers["bias"] = offset * config.bias_std * float(rng.standard_normal())
        numbers["scale"] = offset * config.scale_std * float(rng.standard_normal())
        return numbers

    def apply(
        self, frame: RgbdFrame, numbers: Mapping[str, float], rng: np.random.Generator
    ) -> RgbdFrame:
        """`frame` with its depth disturbed by the `numbers` of `draw`; colour is shared."""
        if not any(numbers.values()):
            return frame
        margin = 2 + int(np.ceil(3.0 * self._jitter_px(numbers)))
        window = Window(*measured_window(frame.depth, margin))
        # All draws happen whatever the picture holds, so that the stream stays in step.
        rows = starts(rng, frame.depth.shape[0])
        nodes = rng.standard_normal(self._node_shape(frame.depth.shape), dtype=np.float32)
        blobs = draw_blobs(rng, window, numbers["holes"])
        if window.bottom == window.top:
            return frame
        depth = self._disturbed(frame, window, numbers, rows, nodes)
        punch(depth, blobs)
        return dataclasses.replace(frame, depth=depth)

    def _disturbed(
        self,
        frame: RgbdFrame,
        window: Window,
        numbers: Mapping[str, float],
        rows: NDArray[np.int64],
        nodes: Float32,
    ) -> Float32:
        height, width = frame.depth.shape
        K = frame.camera.K
        distance2 = edge_distance2(frame.depth, window, jump=JUMP)
        edge_drop = np.minimum(numbers["edges"] * self._edge_drop, 1.0).astype(np.float32)
        grid = (weights(height, nodes.shape[0]), weights(width, nodes.shape[1]))
        if not self._metric:
            return disparity_noise(
                frame.depth,
                window,
                distance2,
                float(K[0, 0]),
                self._disparity,
                DisparityStrengths(
                    self._jitter_px(numbers), numbers["axial"], numbers["bias"], numbers["scale"]
                ),
                edge_drop=edge_drop,
                pool=self._pool,
                dots=self._dots,
                nodes=nodes,
                grid=grid,
                starts=rows,
            )
        sensor = self._axial
        strengths = AxialStrengths(
            jitter=self._jitter_px(numbers),
            axial=numbers["axial"],
            smooth=numbers["smooth"] * sensor.smooth_share,
            incidence=numbers["incidence"],
            unit=sensor.unit if self.config.quantise and self.config.strength > 0.0 else 0.0,
            bias=numbers["bias"],
            scale=numbers["scale"],
        )
        return axial_noise(
            frame.depth,
            window,
            distance2,
            Lens(float(K[0, 0]), float(K[1, 1]), float(K[0, 2]), float(K[1, 2])),
            sensor,
            strengths,
            edge_drop=edge_drop,
            pool=self._pool,
            nodes=nodes,
            grid=grid,
            starts=rows,
            jump=JUMP,
        )

    def _jitter_px(self, numbers: Mapping[str, float]) -> float:
        family = self._axial if self._metric else self._disparity
        return numbers["jitter"] * family.jitter_px

    def _node_shape(self, shape: tuple[int, ...]) -> tuple[int, int]:
        if self._metric or self._disparity.cell_px == 0:
            return COARSE, COARSE
        cell = self._disparity.cell_px
        return shape[0] // cell + 2, shape[1] // cell + 2
