"""A small honest robot with two arms: kinematics that can be checked by hand, and its far end.

Each arm is a spherical crane: joint 0 turns it about z, joint 1 raises it, joint 2 extends it
(0.1 m a radian around 0.3 m), joints 3 to 6 are a wrist that does not move the gripper. Speeds and
accelerations are limited exactly, jerk is not.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from types import SimpleNamespace, TracebackType
from typing import Self

import numpy as np
from typing_extensions import override

from clothrf_core.errors import RefusedTarget
from clothrf_core.hookspecs import hookimpl
from clothrf_core.interfaces import ArmModel, BridgeEnd, JointLimiter, JointLimits
from clothrf_core.provider import Provider
from clothrf_core.registry import Registry
from clothrf_core.types import Float

BASES = np.array([[0.1, -0.15, 0.4], [0.1, 0.15, 0.4]])
REACH, PER_RADIAN = 0.3, 0.1


class CraneLimits(JointLimits):
    """The same for all 14 joints."""

    def __init__(self, speed: float = 1.5, acceleration: float = 20.0) -> None:
        self._ones = np.ones(14)
        self._speed = speed
        self._acceleration = acceleration

    @property
    @override
    def lower(self) -> Float:
        return -1.5 * self._ones

    @property
    @override
    def upper(self) -> Float:
        return 1.5 * self._ones

    @property
    @override
    def soft_lower(self) -> Float:
        return -1.4 * self._ones

    @property
    @override
    def soft_upper(self) -> Float:
        return 1.4 * self._ones

    @property
    @override
    def velocity(self) -> Float:
        return self._speed * self._ones

    @property
    @override
    def acceleration(self) -> Float:
        return self._acceleration * self._ones

    @property
    @override
    def cruise(self) -> Float:
        return self._acceleration * self._ones

    @property
    @override
    def jerk(self) -> Float:
        return 1e4 * self._ones


class CraneLimiter(JointLimiter):
    """Discrete time-optimal motion with limited speed and acceleration."""

    def __init__(self, limits: JointLimits, dt: float, q: Float) -> None:
        self._low, self._high = limits.soft_lower, limits.soft_upper
        self._v, self._a, self._dt = limits.velocity, limits.acceleration, dt
        self._q, self._qd, self._qdd = np.array(q, float), np.zeros(len(q)), np.zeros(len(q))

    @override
    def tick(self, target: Float) -> tuple[Float, Float, Float]:
        if np.shape(target) != self._q.shape or not np.isfinite(target).all():
            raise RefusedTarget(f"target: expected {len(self._q)} finite angles, found {target}")
        error = np.clip(target, self._low, self._high) - self._q
        # Greatest speed from which the rest of the way suffices to stop in whole ticks.
        step = self._a * self._dt
        speed = np.sqrt((0.5 * step) ** 2 + 2.0 * self._a * np.abs(error)) - 0.5 * step
        return self._towards(np.sign(error) * np.minimum(speed, np.abs(error) / self._dt))

    @override
    def stop(self) -> tuple[Float, Float, Float]:
        return self._towards(np.zeros(len(self._q)))

    @property
    @override
    def at_rest(self) -> bool:
        return not self._qd.any()

    def _towards(self, speed: Float) -> tuple[Float, Float, Float]:
        wanted = np.clip(speed, -self._v, self._v)
        change = np.clip(wanted - self._qd, -self._a * self._dt, self._a * self._dt)
        self._qd = self._qd + change
        self._qdd = change / self._dt
        self._q = self._q + self._qd * self._dt
        return self._q, self._qd, self._qdd


class CraneArms(ArmModel):
    """Two cranes; gripper 0 at negative y."""

    def __init__(self, speed: float = 1.5) -> None:
        self._limits = CraneLimits(speed)
        self._names = tuple(f"{side}_{i}" for side in ("right", "left") for i in range(7))

    @property
    @override
    def joint_names(self) -> tuple[str, ...]:
        return self._names

    @property
    @override
    def limits(self) -> JointLimits:
        return self._limits

    @property
    @override
    def ready(self) -> Float:
        return np.zeros(14)

    @override
    def grasp_points(self, q: Float) -> Float:
        turn, rise, out = np.reshape(q, (2, 7))[:, :3].T
        reach = REACH + PER_RADIAN * out
        flat = reach * np.cos(rise)
        points: Float = BASES + np.stack(
            [flat * np.cos(turn), flat * np.sin(turn), reach * np.sin(rise)], axis=1
        )
        return points

    @override
    def solve(self, q: Float, targets: Float, dt: float) -> Float:
        if not np.isfinite(targets).all():
            raise RefusedTarget(f"targets: expected finite metres, found {targets.tolist()}")
        offset = targets - BASES
        reach = np.linalg.norm(offset, axis=1)
        joints = np.array(q, float).reshape(2, 7)
        joints[:, 0] = np.arctan2(offset[:, 1], offset[:, 0])
        joints[:, 1] = np.arcsin(np.clip(offset[:, 2] / np.maximum(reach, 1e-9), -1.0, 1.0))
        joints[:, 2] = (reach - REACH) / PER_RADIAN
        wanted: Float = joints.ravel()
        low, high = self._limits.soft_lower, self._limits.soft_upper
        if (wanted < low).any() or (wanted > high).any():
            raise RefusedTarget(f"targets: expected points in reach, found {targets.tolist()}")
        step = self._limits.velocity * dt
        return q + np.clip(wanted - q, -step, step)

    @override
    def clearance(self, q: Float) -> tuple[float, str]:
        points = self.grasp_points(q)
        apart = float(np.linalg.norm(points[0] - points[1])) - 0.1
        above = float(points[:, 2].min()) - 0.05
        return (apart, "left-right") if apart < above else (above, "gripper-table")

    @override
    def grasp_speeds(self, q: Float, qd: Float) -> Float:
        h = 1e-6
        moved = self.grasp_points(q + h * qd) - self.grasp_points(q - h * qd)
        speeds: Float = np.linalg.norm(moved, axis=1) / (2.0 * h)
        return speeds

    @override
    def limiter(self, dt: float, *, q: Float) -> JointLimiter:
        return CraneLimiter(self._limits, dt, q)

    @override
    def capsules(self, q: Float) -> Sequence[tuple[Float, Float, float]]:
        return [
            (base, point, 0.05) for base, point in zip(BASES, self.grasp_points(q), strict=True)
        ]


class PerfectEnd(BridgeEnd):
    """An end whose arms are at once where they are told to be; keeps every posture it was given.

    Attributes:
        connected: set False to pretend that the controller went away.
        log: all (q, qd) put so far, at most `keep`.
    """

    def __init__(self, q: Float, keep: int = 100_000) -> None:
        self.connected = True
        self.log: list[tuple[Float, Float]] = []
        self._keep = keep
        self._state = (np.array(q, float), np.zeros(len(q)))

    @override
    def __enter__(self) -> Self:
        return self

    @override
    def __exit__(
        self,
        kind: type[BaseException] | None,
        error: BaseException | None,
        trace: TracebackType | None,
    ) -> None:
        self.connected = False

    @override
    def measured(self) -> tuple[Float, Float] | None:
        return self._state if self.connected else None

    @override
    def put(self, q: Float, qd: Float) -> None:
        self._state = (q, qd)
        if len(self.log) < self._keep:
            self.log.append(self._state)

    @override
    def health(self) -> Mapping[str, float]:
        return {"cycles": float(len(self.log)), "missed": 0.0, "age_s": 0.0}


@hookimpl
def clothrf_arms() -> list[Provider[ArmModel]]:
    """The cranes, as ``plugin = "crane"``."""
    return [Provider("crane", "two spherical cranes", lambda _options, _context: CraneArms())]


@hookimpl
def clothrf_bridge_ends() -> list[Provider[BridgeEnd]]:
    """Their far end, as ``plugin = "perfect"``."""
    return [
        Provider(
            "perfect", "goes at once", lambda _options, _context: PerfectEnd(CraneArms().ready)
        )
    ]


def crane_registry() -> Registry:
    """A registry that knows the cranes and nothing else."""
    hooks = SimpleNamespace(clothrf_arms=clothrf_arms, clothrf_bridge_ends=clothrf_bridge_ends)
    return Registry.of(hooks)
