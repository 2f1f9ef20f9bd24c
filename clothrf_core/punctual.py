"""Being on time: real-time scheduling, and no help from threads that may come late."""

from __future__ import annotations

import contextlib
import os
import sys
from collections.abc import Iterator

FIFO_PRIORITY = 20


@contextlib.contextmanager
def punctual(priority: int = FIFO_PRIORITY) -> Iterator[str]:
    """SCHED_FIFO for this thread and those it starts; gives what was granted, in words.

    Args:
        priority: 1 to 99; 0 leaves the scheduling as it is.
    """
    if priority <= 0 or not hasattr(os, "sched_setscheduler"):
        yield "default"
        return
    before, parameters = os.sched_getscheduler(0), os.sched_getparam(0)
    try:
        os.sched_setscheduler(0, os.SCHED_FIFO, os.sched_param(priority))
    except PermissionError:
        yield "default (no permission for SCHED_FIFO)"
        return
    try:
        yield f"SCHED_FIFO {priority}"
    finally:
        os.sched_setscheduler(0, before, parameters)


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
