"""Being on time: real-time scheduling, and no help from threads that may come late."""

from __future__ import annotations

import contextlib
import os
import sys
from collections.abc import Iterator

FIFO_PRIORITY = 20
NICER = 10


@contextlib.contextmanager
def punctual(priority: int = FIFO_PRIORITY, *, cpu: int | None = None) -> Iterator[str]:
    """Real-time scheduling for this thread and those it starts; gives what was granted, in words.

    SCHED_FIFO where permitted, else a better nice value, else nothing. Enter it before opening a
    network: its threads inherit the scheduling, and a loop that outruns them loses messages.

    Args:
        priority: 1 to 99; 0 leaves the scheduling as it is.
        cpu: the core to stay on; None = any.
    """
    with contextlib.ExitStack() as before:
        if cpu is not None and hasattr(os, "sched_setaffinity"):
            cores = os.sched_getaffinity(0)
            with contextlib.suppress(OSError):
                os.sched_setaffinity(0, {cpu})
                before.callback(os.sched_setaffinity, 0, cores)
        yield _scheduled(priority, before) if priority > 0 else "default"


def _scheduled(priority: int, before: contextlib.ExitStack) -> str:
    """Ask for better scheduling and say what was granted; `before` takes it back."""
    if hasattr(os, "sched_setscheduler"):
        policy, parameters = os.sched_getscheduler(0), os.sched_getparam(0)
        with contextlib.suppress(OSError):
            os.sched_setscheduler(0, os.SCHED_FIFO, os.sched_param(priority))
            before.callback(os.sched_setscheduler, 0, policy, parameters)
            return f"SCHED_FIFO {priority}"
    with contextlib.suppress(OSError, AttributeError):
        os.nice(-NICER)
        before.callback(os.nice, NICER)
        return f"nice -{NICER}"
    return "default (no permission for SCHED_FIFO)"


@contextlib.contextmanager
def alone() -> Iterator[None]:
    """OpenCV, where it is loaded, without threads of its own.

    What it does to one picture is over in 0.1 ms; a helping thread that waits for a core of a busy
    machine takes milliseconds.
    """
    cv2 = sys.modules.get("cv2")
    if cv2 is None:
        yield
        return
    before = cv2.getNumThreads()
    cv2.setNumThreads(1)
    try:
        yield
    finally:
        cv2.setNumThreads(before)
