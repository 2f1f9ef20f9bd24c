"""The `Simulator` on MuJoCo's flex."""

from __future__ import annotations

from collections import OrderedDict
from collections.abc import Hashable

import numpy as np
from typing_extensions import override

from clothrf_core.errors import ClothrfError, ShapeError
from clothrf_core.interfaces import Simulator
from clothrf_core.params import SimulationParams
from clothrf_core.sheet import hung, reachable
from clothrf_core.types import ClothMesh, ClothState, Float
from clothrf_mujoco.config import FlexOptions
from clothrf_mujoco.flex import Flex, flex
from clothrf_mujoco.stepping import Stepper

SETTLE_STEP = 1.0 / 30.0
SETTLE_DRAG = 10.0
JITTER = 1e-5
KEPT = 4
"""Compiled cloths kept, latest first."""


class FlexSimulator(Simulator):
    """One cloth of finite elements, held by four corners."""

    def __init__(self, options: FlexOptions) -> None:
        self._options = options
        self._compiled: OrderedDict[Hashable, Flex] = OrderedDict()
        self._stepper: Stepper | None = None
        self._size = (0.0, 0.0)
        self._drag = 0.0
        self._time = 0.0

    @override
    def reset(self, rng: np.random.Generator, params: SimulationParams) -> ClothState:
        cloth = self._flex(params)
        corners = np.concatenate([params.hands, params.grasp])
        start = hung(cloth.mesh.rest, corners)
        start += rng.normal(scale=JITTER, size=start.shape)
        self._stepper = Stepper(cloth, self._options, start, corners)
        self._size, self._drag, self._time = params.size, params.fabric.drag, 0.0
        for _ in range(int(np.ceil(params.settle_s / SETTLE_STEP - 1e-9))):
            self._stepper.advance(corners, SETTLE_STEP, drag=self._drag + SETTLE_DRAG)
        return self._state(self._stepper)

    @override
    def step(self, grasp_targets: Float, hands: Float, dt: float) -> ClothState:
        stepper = self._ready()
        corners = np.concatenate([_corners("hands", hands), _corners("grasp", grasp_targets)])
        if not (np.isfinite(dt) and dt > 0.0):
            raise ShapeError(f"step: expected dt > 0 seconds, got {dt}")
        stepper.advance(corners, dt, drag=self._drag)
        self._time += dt
        return self._state(stepper)

    @override
    def mesh(self) -> ClothMesh:
        return self._ready().cloth.mesh

    def _ready(self) -> Stepper:
        if self._stepper is None:
            raise ClothrfError("cloth: expected reset() before this call; call reset() first")
        return self._stepper

    def _flex(self, params: SimulationParams) -> Flex:
        """The compiled cloth; compiling takes as long as some twenty steps."""
        key = (params.size, params.resolution, params.fabric, params.self_collision)
        if key not in self._compiled:
            self._compiled[key] = flex(params, self._options)
        self._compiled.move_to_end(key)
        while len(self._compiled) > KEPT:
            self._compiled.popitem(last=False)
        return self._compiled[key]

    def _state(self, stepper: Stepper) -> ClothState:
        corners = stepper.corners
        return ClothState(
            vertices=stepper.vertices(),
            velocities=stepper.velocities(),
            hands=corners[:2].copy(),
            grasp=corners[2:].copy(),
            feasible=reachable(corners, self._size),
            time_s=self._time,
        )


def _corners(name: str, points: Float) -> Float:
    points = np.asarray(points, float)
    if points.shape != (2, 3) or not np.isfinite(points).all():
        raise ShapeError(
            f"step: expected finite {name} of shape (2, 3), got shape {points.shape}"
            + ("" if np.isfinite(points).all() else " with NaN or infinity")
        )
    return points
