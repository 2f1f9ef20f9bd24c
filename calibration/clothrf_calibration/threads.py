"""Keeps the linear algebra on one core: for small matrices, threads only get in the way."""

from __future__ import annotations

import contextlib
import importlib


def one_thread() -> contextlib.AbstractContextManager[object]:
    """Limits BLAS to one thread inside the block, where threadpoolctl is installed."""
    try:
        control = importlib.import_module("threadpoolctl")
    except ImportError:
        return contextlib.nullcontext()
    limits: contextlib.AbstractContextManager[object] = control.threadpool_limits(limits=1)
    return limits
