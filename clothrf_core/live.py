"""Running a trained policy: on a real camera and robot, on simulated ones, or half and half.

With a rendered camera and a robot that is not the simulated one, the simulated cloth hangs on the
grippers that the robot reports: a rehearsal of the real thing with everything but light and cloth.
"""

from __future__ import annotations

import time
from collections.abc import Callable, Mapping
from contextlib import ExitStack
from dataclasses import dataclass, field
from typing import Any

import numpy as np
from typing_extensions import override

from clothrf_core import compose, config
from clothrf_core.clock import Clock, WallClock, ticks
from clothrf_core.errors import ConfigError, suggestion
from clothrf_core.interfaces import Camera, Policy, RenderedCamera, Robot
from clothrf_core.limits import Limits
from clothrf_core.loop import Controller, Observer, Step
from clothrf_core.opening import CameraAround
from clothrf_core.provider import BuildContext
from clothrf_core.punctual import alone, punctual
from clothrf_core.registry import Registry
from clothrf_core.simulated import SimulatedCamera, SimulatedRobot, SimulatedWorld
from clothrf_core.types import RgbdFrame, RobotCommand

# Of SCHED_FIFO; less than `punctual.FIFO_PRIORITY`, with which a bridge watches over the arms.
LOOP_PRIORITY = 10


class RehearsalCamera(CameraAround):
    """Draws simulated cloth that hangs on the grippers of a robot that is not simulated here.

    Each `read` lets one control period pass: the hands move, and the cloth's grasped corners go
    where the robot says its grippers are.
    """

    def __init__(self, camera: SimulatedCamera, world: SimulatedWorld, robot: Robot) -> None:
        super().__init__(camera)
        self._camera = camera
        self._world = world
        self._robot = robot
        self._sequence = 0

    @override
    def read(self, timeout_s: float = 1.0) -> RgbdFrame:
        here = self._robot.state()
        follow = RobotCommand(self._sequence, here.stamp_ns, 1.0, np.array(here.positions))
        self._sequence += 1
        self._world.advance(follow)
        return self._camera.read(timeout_s)


@dataclass
class Pulse:
    """Rate and latency of a running loop, for a live line and a summary.

    Attributes:
        window: how many of the last turns count.
    """

    window: int = 90
    stamps_ns: list[int] = field(default_factory=list)
    held: int = 0
    turns: int = 0
    confidence: float = 0.0
    why: str = ""
    reasons: dict[str, int] = field(default_factory=dict)

    def on_step(self, step: Step) -> None:
        """Count a turn."""
        self.stamps_ns = [*self.stamps_ns[-self.window :], time.monotonic_ns()]
        self.turns += 1
        self.held += bool(step.sent.held)
        if step.sent.held:
            self.reasons[step.sent.held] = self.reasons.get(step.sent.held, 0) + 1
        self.confidence = step.action.confidence
        self.why = step.sent.held

    @property
    def rate_hz(self) -> float:
        """Turns a second over the window."""
        if len(self.stamps_ns) < 2:
            return 0.0
        span = self.stamps_ns[-1] - self.stamps_ns[0]
        return (len(self.stamps_ns) - 1) * 1e9 / span if span > 0 else 0.0

    @property
    def jitter_ms(self) -> float:
        """99th percentile of the deviation of a period from their median."""
        if len(self.stamps_ns) < 3:
            return 0.0
        periods = np.diff(self.stamps_ns) * 1e-6
        return float(np.percentile(np.abs(periods - np.median(periods)), 99))


@dataclass(frozen=True)
class Session:
    """A wired loop, ready to run.

    `grasp_error` tells, with simulated cloth, how far the grippers are from x* now, m. `priority`
    is the loop's of SCHED_FIFO where a camera paces it and the system permits; 0 = as it comes.
    """

    controller: Controller
    rate_hz: float
    paced_by_camera: bool
    grasp_error: Callable[[], float] | None = None
    priority: int = LOOP_PRIORITY

    def run(
        self,
        *,
        seconds: float | None,
        observers: tuple[Observer, ...] = (),
        clock: Clock | None = None,
        stopped: Callable[[], bool] = lambda: False,
    ) -> int:
        """Run until `seconds` have passed, the camera ends, or `stopped`; returns the turns.

        The robot is entered before the camera and left after it, so that its arms stop last
        whatever happened. A loop that a camera paces sleeps most of the time: it asks for real-time
        scheduling, below a bridge's. A simulated one may take a whole core and does not.
        """
        clock = clock or WallClock()
        end_ns = None if seconds is None else clock.now_ns() + round(seconds * 1e9)
        turns = 0
        with ExitStack() as stack:
            stack.enter_context(self.controller.robot)
            stack.enter_context(self.controller.camera)
            stack.enter_context(alone())
            stack.enter_context(punctual(self.priority if self.paced_by_camera else 0))
            for sequence in ticks(clock, 1e6 if self.paced_by_camera else self.rate_hz):
                if stopped() or (end_ns is not None and clock.now_ns() >= end_ns):
                    break
                step = self.controller.step(sequence)
                for observer in observers:
                    observer.on_step(step)
                turns += 1
        return turns


def session(
    resolved: config.Resolved, registry: Registry, policy: Policy, task: str, *, seed: int = 0
) -> Session:
    """Wire camera, features, policy, limits and robot as the config says.

    Raises:
        ConfigError: the policy does not know the task, or the parts do not fit together.
    """
    if task not in policy.tasks:
        raise ConfigError(f"no task '{task}' in this policy. {suggestion(task, policy.tasks)}")
    rate = resolved.experiment.run.rate_hz
    limits = Limits(resolved.experiment.limits, 1.0 / rate)
    extractor = compose.extractor(resolved, registry)
    simulated_robot = resolved.components["robot"].plugin == "simulated"
    camera: Camera = _probe(resolved, registry)
    if not isinstance(camera, RenderedCamera):
        if simulated_robot:
            raise ConfigError(
                "robot.plugin: a real camera cannot see the simulated robot; "
                "choose a robot that moves, or a rendered camera"
            )
        robot = compose.robot(resolved, registry, None)
        return Session(
            Controller(camera, extractor, policy, limits, robot, task), rate, paced_by_camera=True
        )
    shop = compose.workshop(resolved, registry)
    lead = shop.experts.get(task) or next(iter(shop.experts.values()))

    def grasp_error() -> float:
        state = shop.world.state
        return float(np.linalg.norm(state.grasp - lead.label(state).targets, axis=1).mean())

    shop.world.reset(np.random.SeedSequence(seed), lead)
    if simulated_robot:
        mover: Robot = SimulatedRobot(shop.world)
        eye: Camera = shop.camera
    else:
        mover = compose.robot(resolved, registry, shop.world)
        eye = RehearsalCamera(shop.camera, shop.world, mover)
    return Session(
        Controller(eye, extractor, policy, limits, mover, task),
        rate,
        paced_by_camera=False,
        grasp_error=grasp_error,
    )


def live_line(pulse: Pulse, robot: Robot) -> str:
    """Rate, confidence and what robot and bridge say about themselves, as one line."""
    parts = [
        f"{pulse.rate_hz:5.1f} Hz",
        f"jitter {pulse.jitter_ms:4.1f} ms",
        f"confidence {pulse.confidence:.2f}",
    ]
    status: Mapping[str, Any] = getattr(robot, "status", dict)()
    parts += [f"{key} {_short(value)}" for key, value in status.items() if value != ""]
    if pulse.why:
        parts.append(f"holding: {pulse.why}")
    return "  ".join(parts)


def _probe(resolved: config.Resolved, registry: Registry) -> Camera:
    context = BuildContext(rig=resolved.rig, folder=resolved.folder, registry=registry)
    chosen = resolved.components["camera"]
    camera: Camera = registry.build("camera", chosen.plugin, chosen.options, context)
    return camera


def _short(value: object) -> str:
    return f"{value:.3g}" if isinstance(value, float) else str(value)
