"""The newest value between two processes: never blocks, never queues, never half-read.

The writer fills the next of four slots and then moves the counter on; a reader copies the slot that
the counter names and looks again: unless three more values came meanwhile, what it copied is whole.
A writer that is interrupted, or killed, in the middle leaves the last whole value readable. One
writer, any number of readers.
"""

from __future__ import annotations

import struct
from dataclasses import dataclass, field
from multiprocessing.context import SpawnContext
from typing import Any, ClassVar

import numpy as np

from clothrf_core.types import Float

_COUNT = struct.Struct("<q")
SLOTS = 4


def _origin() -> Float:
    return np.zeros((2, 3))


class Mailbox:
    """Fixed-size bytes in shared memory; picklable only into a spawned process.

    Args:
        context: whose processes share it.
        size: bytes of every value.
    """

    def __init__(self, context: SpawnContext, size: int) -> None:
        self._memory: Any = context.RawArray("B", _COUNT.size + SLOTS * size)
        self._size = size

    def put(self, value: bytes) -> None:
        """Replace the value."""
        if len(value) != self._size:
            raise ValueError(f"Mailbox: expected {self._size} bytes, found {len(value)}")
        view = memoryview(self._memory).cast("B")
        count = _COUNT.unpack_from(view)[0] + 1
        start = _COUNT.size + count % SLOTS * self._size
        view[start : start + self._size] = value
        _COUNT.pack_into(view, 0, count)

    def get(self) -> bytes | None:
        """The newest value; None before the first."""
        view = memoryview(self._memory).cast("B")
        while True:
            count = _COUNT.unpack_from(view)[0]
            if count == 0:
                return None
            start = _COUNT.size + count % SLOTS * self._size
            value = bytes(view[start : start + self._size])
            if _COUNT.unpack_from(view)[0] - count < SLOTS - 1:
                return value


@dataclass(frozen=True, slots=True, eq=False)
class Wish:
    """What the controller wants of the stream.

    Attributes:
        number: counts commands of `Robot.send`.
        sent_ns: monotonic time of the last one.
        valid_for_s: its life.
        arm_requests: counts explicit requests for the arms.
        hold: stand still instead of going to `targets`.
        leave: stop the arms, give them back, end the process.
        targets: (2, 3) float64, world, m.
    """

    number: int = 0
    sent_ns: int = 0
    valid_for_s: float = 0.0
    arm_requests: int = 0
    hold: bool = True
    leave: bool = False
    targets: Float = field(default_factory=_origin)

    LAYOUT: ClassVar[struct.Struct] = struct.Struct("<qqdq??6x6d")

    def encode(self) -> bytes:
        """Bytes for a mailbox."""
        return self.LAYOUT.pack(
            self.number,
            self.sent_ns,
            self.valid_for_s,
            self.arm_requests,
            self.hold,
            self.leave,
            *self.targets.ravel(),
        )

    @classmethod
    def decode(cls, data: bytes) -> Wish:
        """What `encode` wrote."""
        values = cls.LAYOUT.unpack(data)
        number, sent_ns, valid_for_s, arm_requests, hold, leave = values[:6]
        targets = np.array(values[6:]).reshape(2, 3)
        return cls(number, sent_ns, valid_for_s, arm_requests, hold, leave, targets)


@dataclass(frozen=True, slots=True, eq=False)
class News:
    """What the stream tells the controller.

    Attributes:
        phase: connecting, ready, streaming, stopped or failed.
        bridge: the bridge's state, "" before the first news.
        why: why the bridge or the stream stands still.
        measured_ns: monotonic time when `grasp` arrived.
        grasp: (2, 3) float64 measured grippers, world, m.
        arm_answers: explicit requests for the arms that have been answered.
        sent: joint commands sent.
        refused: targets that the arm model refused.
        rate_hz: joint commands a second, lately.
        lateness_p99_us: of the stream's own loop.
        least_clearance: smallest clearance the bridge has seen, m.
    """

    phase: str = "connecting"
    bridge: str = ""
    why: str = ""
    measured_ns: int = 0
    grasp: Float = field(default_factory=_origin)
    arm_answers: int = 0
    sent: int = 0
    refused: int = 0
    rate_hz: float = 0.0
    lateness_p99_us: float = 0.0
    least_clearance: float = 0.0

    LAYOUT: ClassVar[struct.Struct] = struct.Struct("<16s16s512sq6dqqqddd")

    def encode(self) -> bytes:
        """Bytes for a mailbox; long texts are cut."""
        return self.LAYOUT.pack(
            self.phase.encode()[:16],
            self.bridge.encode()[:16],
            self.why.encode()[:512],
            self.measured_ns,
            *self.grasp.ravel(),
            self.arm_answers,
            self.sent,
            self.refused,
            self.rate_hz,
            self.lateness_p99_us,
            self.least_clearance,
        )

    @classmethod
    def decode(cls, data: bytes) -> News:
        """What `encode` wrote."""
        values = cls.LAYOUT.unpack(data)
        phase, bridge, why = (t.rstrip(b"\x00").decode(errors="replace") for t in values[:3])
        grasp = np.array(values[4:10]).reshape(2, 3)
        answers, sent, refused, rate, late, clearance = values[10:]
        return cls(
            phase, bridge, why, values[3], grasp, answers, sent, refused, rate, late, clearance
        )
