"""The `Simulator`: cloth held by four corners, one or many at a time."""

from __future__ import annotations

import math
from collections.abc import Sequence

import numpy as np
from typing_extensions import override

from clothrf_core.errors import ClothrfError, ConfigError, ShapeError
from clothrf_core.interfaces import Simulator
from clothrf_core.params import SimulationParams
from clothrf_core.sheet import hung, reachable
from clothrf_core.types import ClothMesh, ClothState, Float
from clothrf_sapien.cloth import Cloths
from clothrf_sapien.config import ClothOptions
from clothrf_sapien.weave import Weave, weave

SETTLE_STEP = 1.0 / 30.0
SETTLE_DRAG = 10.0
JITTER = 1e-5
UNFOLDING = ((5e-4, 2000.0), (2e-3, 500.0), (5e-3, 100.0))
"""Steps, s, and drags, 1/s, that a cloth with self-collision begins to settle with."""


class ClothBatch:
    """N cloths of one resolution, stepped by one call; each as if it were alone, bit for bit."""

    def __init__(self, options: ClothOptions) -> None:
        self._options = options
        self._cloths: Cloths | None = None
        self._weaves: list[Weave] = []
        self._times = np.zeros(0)

    def reset(
        self, rngs: Sequence[np.random.Generator], params: Sequence[SimulationParams]
    ) -> list[ClothState]:
        """Hang N cloths and let them settle; one generator and one set of params each.

        Raises:
            ConfigError: the resolutions differ, or a number is out of range.
        """
        if len(rngs) != len(params) or not params:
            raise ConfigError(
                f"cloths: expected one generator for each of N >= 1 params, got {len(rngs)} "
                f"generators and {len(params)} params"
            )
        resolutions = {p.resolution for p in params}
        if len(resolutions) != 1:
            raise ConfigError(
                "cloths: expected one resolution for all cloths of a batch, got "
                f"{sorted(resolutions)}; use one batch for each"
            )
        o = self._options
        weaves = [
            weave(p, strain_limit=o.strain_limit, taut=o.taut, thickness=o.thickness)
            for p in params
        ]
        corners = np.stack([np.concatenate([p.hands, p.grasp]) for p in params])
        vertices = np.stack(
            [_start(w, c, rng) for w, c, rng in zip(weaves, corners, rngs, strict=True)]
        )
        self._weaves = weaves
        self._cloths = Cloths(weaves, vertices, weaves[0].mesh.corners.astype(np.int64))
        self._settle(corners, [p.settle_s for p in params])
        self._times = np.zeros(len(params))
        return self._states()

    def step_many(
        self, grasp_targets: Float, hands: Float, dt: float, *, threads: int = 1
    ) -> list[ClothState]:
        """Move the corners of all cloths linearly over `dt` seconds.

        Args:
            grasp_targets: (N, 2, 3) float64, world.
            hands: (N, 2, 3) float64, world.
            dt: seconds.
            threads: Python threads that share the cloths; the result does not depend on it.

        Raises:
            ClothrfError: `reset` has not been called.
            ShapeError: wrong shapes, numbers that are not finite, or ``dt <= 0``.
        """
        cloths = self._ready()
        corners = np.concatenate(
            [
                _corners("hands", hands, cloths.count),
                _corners("grasp", grasp_targets, cloths.count),
            ],
            axis=1,
        )
        if not (math.isfinite(dt) and dt > 0.0):
            raise ShapeError(f"step: expected dt > 0 seconds, got {dt}")
        o = self._options
        cloths.advance(
            corners,
            dt,
            substeps=o.substeps,
            iterations=o.iterations,
            tolerance=o.tolerance,
            threads=threads,
        )
        self._times = self._times + dt
        return self._states()

    def mesh(self) -> ClothMesh:
        """Topology of the first cloth."""
        self._ready()
        return self._weaves[0].mesh

    def _ready(self) -> Cloths:
        if self._cloths is None:
            raise ClothrfError("cloth: expected reset() before this call; call reset() first")
        return self._cloths

    def _settle(self, corners: Float, seconds: list[float]) -> None:
        """Let the cloths hang with fixed corners in thick air."""
        cloths = self._ready()
        o = self._options
        longest = max(seconds)
        layered = [k for k, w in enumerate(self._weaves) if w.layers[0] > 0.0]
        for step_s, drag in UNFOLDING if layered else ():
            # The first shape is only roughly as long as its threads: let it relax so slowly that
            # no layer passes through another between two looks.
            for _ in range(20):
                cloths.advance(
                    corners,
                    step_s,
                    substeps=1,
                    iterations=o.iterations,
                    tolerance=o.tolerance,
                    extra_drag=drag,
                    only=layered,
                )
        for i in range(int(np.ceil(longest / SETTLE_STEP - 1e-9))):
            part = [k for k, s in enumerate(seconds) if s > i * SETTLE_STEP + 1e-9]
            cloths.advance(
                corners,
                SETTLE_STEP,
                substeps=o.substeps,
                iterations=o.iterations,
                tolerance=o.tolerance,
                extra_drag=SETTLE_DRAG,
                only=part,
            )

    def _states(self) -> list[ClothState]:
        cloths = self._ready()
        return [
            _state(cloths.x[i].copy(), cloths.v[i].copy(), w, float(t))
            for i, (w, t) in enumerate(zip(self._weaves, self._times, strict=True))
        ]


class ClothSimulator(Simulator):
    """One cloth: a `ClothBatch` of one."""

    def __init__(self, options: ClothOptions) -> None:
        self._batch = ClothBatch(options)

    @override
    def reset(self, rng: np.random.Generator, params: SimulationParams) -> ClothState:
        return self._batch.reset([rng], [params])[0]

    @override
    def step(self, grasp_targets: Float, hands: Float, dt: float) -> ClothState:
        return self._batch.step_many(
            np.asarray(grasp_targets, float)[None], np.asarray(hands, float)[None], dt
        )[0]

    @override
    def mesh(self) -> ClothMesh:
        return self._batch.mesh()


def _start(w: Weave, corners: Float, rng: np.random.Generator) -> Float:
    shape = hung(w.mesh.rest, corners)
    shape += rng.normal(scale=JITTER, size=shape.shape)
    shape[w.mesh.corners] = corners
    return shape


def _corners(name: str, points: Float, count: int) -> Float:
    points = np.asarray(points, float)
    if points.shape != (count, 2, 3) or not np.isfinite(points).all():
        raise ShapeError(
            f"step: expected finite {name} of shape ({count}, 2, 3), got shape {points.shape}"
            + ("" if np.isfinite(points).all() else " with NaN or infinity")
        )
    return points


def _state(x: Float, v: Float, w: Weave, time_s: float) -> ClothState:
    corners = x[w.mesh.corners]
    return ClothState(
        vertices=x,
        velocities=v,
        hands=corners[:2],
        grasp=corners[2:],
        feasible=reachable(corners, w.size),
        time_s=time_s,
    )
