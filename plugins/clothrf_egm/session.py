"""One arm's EGM session: what is answered to each request. No sockets, no clock of its own.

* The controller asks every 4 ms; each request gets one answer at once, whatever else happens.
* A session that starts anew (sequence 0, a new sender, silence) begins with the measured posture:
  an old target is never continued. Targets count again when one is near what was measured.
* Silence from the bridge holds the last posture, at speed zero. Without motors, motion or program
  the answer is the measured posture itself.
"""

from __future__ import annotations

import threading
from dataclasses import dataclass, field

import numpy as np

from clothrf_core.types import Float
from clothrf_egm.mapping import from_egm, to_egm
from clothrf_egm.messages import SensorMessage, decode_robot, encode_sensor
from clothrf_egm.wire import BrokenMessage

Address = tuple[str, int]

# UDP may swap neighbours; a sequence number farther back is a controller that started anew.
REORDER = 10
UNKNOWN: Float = np.full(7, np.nan)  # speeds, until two postures have been measured


@dataclass(frozen=True, slots=True)
class SessionRules:
    """See `EgmConfig` for their meaning; seconds and radians."""

    timeout: float
    silence: float
    start_tolerance: float
    speed_reference: bool


@dataclass(slots=True)
class Counters:
    """What happened since the session object was made."""

    sessions: int = 0
    requests: int = 0
    lost: int = 0
    reordered: int = 0
    broken: int = 0
    foreign: int = 0
    silent: int = 0


@dataclass(frozen=True, slots=True, eq=False)
class _Target:
    q: Float
    qd: Float
    time: float


@dataclass(frozen=True, slots=True, eq=False)
class _Feedback:
    q: Float
    qd: Float
    ready: bool
    sequence: int
    time_ms: int
    time: float


@dataclass(slots=True, eq=False)
class Session:
    """The state of one arm; safe to use from the answering thread and the bridge's at once.

    Attributes:
        rules: times and tolerances.
        counters: what happened.
    """

    rules: SessionRules
    counters: Counters = field(default_factory=Counters)
    _lock: threading.Lock = field(default_factory=threading.Lock)
    _source: Address | None = None
    _feedback: _Feedback | None = None
    _target: _Target | None = None
    _hold: Float | None = None
    _unseen_restart: bool = False
    _sent: int = 0

    def answer(self, data: bytes, source: Address, now: float) -> bytes | None:
        """The reply to a request, or None where there must be none.

        Args:
            data: the datagram.
            source: where it came from.
            now: monotonic seconds.
        """
        try:
            robot = decode_robot(data)
            q = from_egm(robot.joints, robot.external)
            if not np.isfinite(q).all():
                raise BrokenMessage("EgmRobot.feedBack: expected finite angles")
        except BrokenMessage:
            with self._lock:
                self.counters.broken += 1
            return None
        with self._lock:
            last = self._feedback
            quiet = last is None or now - last.time > self.rules.timeout
            if source != self._source and not quiet:
                self.counters.foreign += 1
                return None
            back = 0 if last is None else last.sequence - robot.sequence
            fresh = last is None or quiet or source != self._source
            fresh = fresh or (robot.sequence == 0 and back > 0) or back > REORDER
            if not fresh and back >= 0:
                self.counters.reordered += 1
                return None
            if last is None or fresh:
                self.counters.sessions += 1
                speed = UNKNOWN
                self._sent = 0
            else:
                self.counters.lost += -back - 1
                span = (robot.time_ms - last.time_ms) * 1e-3
                speed = (q - last.q) / span if span > 0.0 else last.qd
            if fresh or not robot.ready or last is None or not last.ready:
                self._start_anew(q)
            self._source = source
            self._feedback = _Feedback(q, speed, robot.ready, robot.sequence, robot.time_ms, now)
            self.counters.requests += 1
            return self._reply(now)

    @property
    def following(self) -> bool:
        """A posture was put since the session began; a new one may differ from the measured."""
        return self._target is not None

    def accepts(self, q: Float) -> bool:
        """Whether `put` may be called with (7,) `q`; a first posture must be near the arm."""
        with self._lock:
            feedback = self._feedback
            if feedback is None or not feedback.ready or self._unseen_restart:
                return False
            if self._target is not None:
                return True
            return bool(np.abs(q - feedback.q).max() <= self.rules.start_tolerance)

    def put(self, q: Float, qd: Float, now: float) -> None:
        """Follow (7,) `q` and `qd`; ignored if the controller has started anew meanwhile."""
        with self._lock:
            if not self._unseen_restart:
                self._target = _Target(q, qd, now)

    def measured(self, now: float) -> tuple[Float, Float] | None:
        """(q, qd), each (7,); None if silent, not ready, or once after a restart."""
        with self._lock:
            restart, self._unseen_restart = self._unseen_restart, False
            feedback = self._feedback
            if feedback is None or restart or not feedback.ready or feedback.qd is UNKNOWN:
                return None
            if now - feedback.time > self.rules.timeout:
                return None
            return feedback.q, feedback.qd

    def age(self, now: float) -> float:
        """Seconds since the last request; infinite before the first."""
        feedback = self._feedback
        return float("inf") if feedback is None else now - feedback.time

    @property
    def ready(self) -> bool:
        """The controller said last that motors, motion and program run."""
        return self._feedback is not None and self._feedback.ready

    def _start_anew(self, q: Float) -> None:
        self._hold, self._target, self._unseen_restart = q, None, True

    def _reply(self, now: float) -> bytes:
        assert self._hold is not None
        speed = np.zeros(7)
        if self._target is not None:
            self._hold = self._target.q
            if now - self._target.time > self.rules.silence:
                self.counters.silent += 1
            else:
                speed = self._target.qd
        joints, external = to_egm(self._hold)
        speeds, external_speeds = to_egm(speed) if self.rules.speed_reference else ((), ())
        sequence, self._sent = self._sent, self._sent + 1
        return encode_sensor(
            SensorMessage(
                sequence=sequence,
                time_ms=int(now * 1e3) & 0xFFFFFFFF,
                joints=joints,
                external=external,
                speeds=speeds,
                external_speeds=external_speeds,
            )
        )
