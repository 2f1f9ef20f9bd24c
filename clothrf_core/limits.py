"""What a policy may ask of a robot: the only place where an `Action` becomes a `RobotCommand`.

Low confidence slows the motion and then holds it; a picture that says nothing holds it; every
target stays in a box and within a speed. The bridge checks all of it again on its own side.
"""

from __future__ import annotations

import math
from dataclasses import dataclass
from functools import cached_property

import numpy as np
from pydantic import Field

from clothrf_core.rig import Section, Vector
from clothrf_core.types import Action, Float, Observation, RobotCommand


class LimitsSection(Section):
    """Config of `[limits]`."""

    max_speed: float = Field(0.5, gt=0.0, le=1.5, description="of each gripper, m/s")
    lead_s: float = Field(
        0.0,
        ge=0.0,
        le=1.0,
        description="how far ahead of the grippers, in seconds at max_speed, targets may lie; "
        "0 = one control period. A robot that lags needs about its lag",
    )
    low: Vector = Field([0.05, -0.60, 0.02], description="box the grippers stay in, world, m")
    high: Vector = Field([0.75, 0.60, 0.80], description="opposite corner of that box")
    max_span: float = Field(0.45, gt=0.0, description="largest distance of the grippers, m")
    slow_below: float = Field(0.30, ge=0.0, le=1.0, description="confidence that slows down")
    hold_below: float = Field(0.05, ge=0.0, le=1.0, description="confidence that holds")
    valid_for_s: float = Field(0.1, gt=0.0, description="a command's life without a successor")


@dataclass(frozen=True)
class Limits:
    """Applies a `LimitsSection` at a control period of `dt` seconds."""

    section: LimitsSection
    dt: float

    def command(self, action: Action, observation: Observation, sequence: int) -> RobotCommand:
        """The command that follows `action` as far as is allowed from where the grippers are.

        Args:
            action: what the policy wants.
            observation: the picture it answers and the grasp at that time.
            sequence: number of the command in this session.
        """
        here = observation.grasp.positions
        targets, held = self._limited(action, np.asarray(here))
        return RobotCommand(
            sequence=sequence,
            stamp_ns=observation.frame.stamp_ns,
            valid_for_s=self.section.valid_for_s,
            targets=targets,
            held=held,
        )

    def _limited(self, action: Action, here: Float) -> tuple[Float, str]:
        limit = self.section
        if action.targets.shape != here.shape:
            return np.array(here), f"expected {here.shape} targets, got {action.targets.shape}"
        if not (np.isfinite(action.targets).all() and math.isfinite(action.confidence)):
            return np.array(here), "targets are not finite"
        if action.confidence <= limit.hold_below:
            return np.array(here), f"confidence {action.confidence:.2f} is too low"
        low, high = self._box
        wanted = np.minimum(np.maximum(action.targets, low), high)
        between = wanted[1] - wanted[0]
        span = math.sqrt(between @ between)
        if span > limit.max_span:
            wanted = wanted.mean(axis=0) + (wanted - wanted.mean(axis=0)) * (limit.max_span / span)
        slow = min(
            1.0,
            (action.confidence - limit.hold_below) / max(limit.slow_below - limit.hold_below, 1e-9),
        )
        reach = limit.max_speed * max(self.dt, limit.lead_s) * slow
        step = wanted - here
        length = np.sqrt((step * step).sum(axis=1, keepdims=True))
        return here + step * np.minimum(1.0, reach / np.maximum(length, 1e-12)), ""

    @cached_property
    def _box(self) -> tuple[Float, Float]:
        """The two corners, (3,) each."""
        return np.array(self.section.low, float), np.array(self.section.high, float)
