"""Time as an argument: the loop asks a clock, and a test gives it one that does not wait."""

from __future__ import annotations

import time
from collections.abc import Iterator
from typing import Protocol


class Clock(Protocol):
    """Monotonic time in nanoseconds, and waiting."""

    def now_ns(self) -> int:
        """Nanoseconds since an arbitrary start; never goes back."""

    def sleep_until_ns(self, deadline_ns: int) -> None:
        """Return at `deadline_ns` or at once if it has passed."""


class WallClock:
    """The machine's monotonic clock."""

    def now_ns(self) -> int:
        """Nanoseconds of ``time.monotonic_ns``."""
        return time.monotonic_ns()

    def sleep_until_ns(self, deadline_ns: int) -> None:
        """Sleep on absolute time, so that delays do not add up."""
        wait = deadline_ns - time.monotonic_ns()
        if wait > 0:
            time.sleep(wait * 1e-9)


class ManualClock:
    """A clock that moves only when told to, or when somebody sleeps on it."""

    def __init__(self, start_ns: int = 0) -> None:
        self._now_ns = start_ns

    def now_ns(self) -> int:
        """The time it was set to."""
        return self._now_ns

    def sleep_until_ns(self, deadline_ns: int) -> None:
        """Jump to `deadline_ns`."""
        self._now_ns = max(self._now_ns, deadline_ns)


def ticks(clock: Clock, rate_hz: float, *, count: int | None = None) -> Iterator[int]:
    """Sequence numbers 0, 1, ... at `rate_hz`; a late tick is followed by the next on time.

    Ticks that were missed altogether are skipped in time, not in number: nothing bursts.
    """
    period_ns = round(1e9 / rate_hz)
    deadline = clock.now_ns()
    sequence = 0
    while count is None or sequence < count:
        yield sequence
        sequence += 1
        deadline += period_ns
        now = clock.now_ns()
        if now > deadline + period_ns:
            deadline = now
        clock.sleep_until_ns(deadline)
