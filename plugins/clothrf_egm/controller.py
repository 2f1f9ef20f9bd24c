"""A simulated ABB controller of one arm: what it sends, and how its arm follows. No sockets.

It models what a client must cope with: the lag of the servo loops, speed limits, CommTimeout (the
session ends, the program starts a new one with sequence 0), motors off, and a clock of its own.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from clothrf_core.types import Float
from clothrf_egm.mapping import from_egm, to_egm
from clothrf_egm.messages import (
    Motion,
    Motors,
    Rapid,
    RobotMessage,
    SensorMessage,
    encode_robot,
)

CYCLE_S = 0.004


@dataclass(frozen=True, slots=True)
class ControllerModel:
    """How one arm behaves.

    Attributes:
        lag: time constant with which joints follow, s.
        speed: greatest joint speeds along the chain, rad/s.
        comm_timeout: without an answer for this long the session ends, s.
        restart: until the program has begun a new session, s; infinite = never.
    """

    lag: float = 0.02
    speed: tuple[float, ...] = tuple(np.radians([180.0] * 4 + [400.0] * 3).tolist())
    comm_timeout: float = 0.2
    restart: float = 0.5


@dataclass(slots=True)
class ControllerCounters:
    """What one arm saw.

    Attributes:
        requests: cycles in which it asked.
        same_cycle: requests answered within their 4 ms.
        timeouts: sessions that ended because nobody answered.
        step: greatest change of the commanded angles from one answer to the next, rad.
    """

    requests: int = 0
    same_cycle: int = 0
    timeouts: int = 0
    step: float = 0.0


class SimulatedController:
    """One arm and its EGM session; call `cycle` every 4 ms.

    Args:
        model: how it behaves.
        posture: (7,) where it stands at first, rad along the chain.

    Attributes:
        q: (7,) where it stands now.
        motors: on, so that it follows.
        unplugged: what it sends goes nowhere, and nothing reaches it.
    """

    def __init__(self, model: ControllerModel, posture: Float) -> None:
        self._model = model
        self.q = np.array(posture, dtype=np.float64)
        self.counters = ControllerCounters()
        self.motors = True
        self.unplugged = False
        self._speed = np.array(model.speed)
        self._decay = float(np.exp(-CYCLE_S / model.lag))
        self._target = self.q.copy()
        self._sequence = 0
        self._time = 0.0
        self._unanswered = 0.0
        self._down_for: float | None = None
        self._asked = False
        self._answered_before = False

    @property
    def running(self) -> bool:
        """EGM is active: the arm would follow."""
        return self.motors and self._down_for is None

    def cycle(self, answer: SensorMessage | None, *, in_time: bool = True) -> bytes | None:
        """Let 4 ms pass.

        Args:
            answer: what came since the last call; the newest if several.
            in_time: it came within 4 ms of the request.

        Returns:
            The next request, or None while the session is down.
        """
        self._time += CYCLE_S
        if self._asked:
            self._take(None if self.unplugged else answer, in_time)
        self._move()
        if self._down_for is not None:
            self._down_for -= CYCLE_S
            if self._down_for > 0.0:
                self._asked = False
                return None
            self.restart()
        if self.motors and self._unanswered > self._model.comm_timeout:
            self.counters.timeouts += 1
            self._target = self.q.copy()
            self._down_for = self._model.restart
            self._asked = False
            return None
        request = self._request()
        self._sequence += 1
        self._asked = True
        self.counters.requests += 1
        return None if self.unplugged else request

    def restart(self) -> None:
        """Begin a new session: sequence 0, standing where the arm is."""
        self._target = self.q.copy()
        self._sequence, self._unanswered, self._down_for = 0, 0.0, None
        self._answered_before = False

    def _take(self, answer: SensorMessage | None, in_time: bool) -> None:  # noqa: FBT001
        if answer is None:
            self._unanswered += CYCLE_S
            return
        self._unanswered = 0.0
        self.counters.same_cycle += in_time
        target = from_egm(answer.joints, answer.external)
        if self._answered_before:
            step = float(np.abs(target - self._target).max())
            self.counters.step = max(self.counters.step, step)
        self._answered_before = True
        if self.motors:
            self._target = target

    def _move(self) -> None:
        if not self.motors:
            self._target = self.q.copy()
            return
        room = self._speed * CYCLE_S
        self.q = self.q + np.clip((self._target - self.q) * (1.0 - self._decay), -room, room)

    def _request(self) -> bytes:
        joints, external = to_egm(self.q)
        planned = sum(to_egm(self._target), ())
        return encode_robot(
            RobotMessage(
                sequence=self._sequence,
                time_ms=round(self._time * 1e3),
                joints=joints,
                external=external,
                motors=Motors.ON if self.motors else Motors.OFF,
                motion=Motion.RUNNING if self.motors else Motion.STOPPED,
                rapid=Rapid.RUNNING,
                planned=planned,
            )
        )
