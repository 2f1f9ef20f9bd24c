"""A loop on absolute time, and how well it keeps it."""

from __future__ import annotations

import gc
import time
from dataclasses import dataclass

import numpy as np

from clothrf_core.clock import Clock


@dataclass(frozen=True, slots=True)
class Spread:
    """Median, 99th percentile and maximum, microseconds."""

    p50: float
    p99: float
    max: float


class Ring:
    """The last `size` durations, in nanoseconds; memory is made once."""

    def __init__(self, size: int = 2500) -> None:
        self._values = np.zeros(size, np.int64)
        self._count = 0

    def add(self, duration_ns: int) -> None:
        """Forget the oldest, keep this one."""
        self._values[self._count % len(self._values)] = duration_ns
        self._count += 1

    def spread(self) -> Spread:
        """Of what is kept; zeros when nothing is."""
        values = self._values[: min(self._count, len(self._values))]
        if not len(values):
            return Spread(0.0, 0.0, 0.0)
        p50, p99, top = np.percentile(values, [50, 99, 100]) / 1e3
        return Spread(float(p50), float(p99), float(top))


class Pace:
    """Waits for the next tick and remembers how late each one was.

    Attributes:
        ticks: ticks so far.
        overruns: ticks that began more than a period late; missed ones are skipped, not made up.
        lateness: how late ticks began.
        work: how long ticks took.
    """

    def __init__(self, clock: Clock, rate_hz: float) -> None:
        self._clock = clock
        self._period_ns = round(1e9 / rate_hz)
        self._deadline = clock.now_ns()
        self._started = self._deadline
        self.ticks = 0
        self.overruns = 0
        self.lateness = Ring()
        self.work = Ring()

    def wait(self) -> int:
        """Sleep until the next tick is due; returns the time it really begins, ns."""
        self.work.add(self._clock.now_ns() - self._started)
        self._deadline += self._period_ns
        self._clock.sleep_until_ns(self._deadline)
        now = self._clock.now_ns()
        late = now - self._deadline
        self.lateness.add(late)
        if late > self._period_ns:
            self.overruns += 1
            self._deadline = now
        self.ticks += 1
        self._started = now
        return now


def settle_memory() -> None:
    """Tell the garbage collector to leave alone what exists; call it before the loop."""
    gc.collect()
    gc.freeze()


def wall_ns() -> int:
    """The wall clock that stamps are compared with across machines."""
    return time.time_ns()
