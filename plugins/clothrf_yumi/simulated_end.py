"""A YuMi at the end of the bridge that needs no sockets: it follows with a first-order lag."""

from __future__ import annotations

import time
from collections.abc import Callable, Mapping
from types import TracebackType
from typing import Self

import numpy as np
from typing_extensions import override

from clothrf_core.interfaces import BridgeEnd
from clothrf_core.types import Float


class SimulatedEnd(BridgeEnd):
    """Joints that approach the posture put last: dq/dt = (q_put - q) / lag, solved exactly.

    Args:
        posture: (J,) where the arms stand at first, rad.
        lag: time constant, s.
        clock: seconds that pass.
    """

    def __init__(
        self, posture: Float, *, lag: float, clock: Callable[[], float] = time.monotonic
    ) -> None:
        self._lag, self._clock = lag, clock
        self._q = np.array(posture, dtype=np.float64)
        self._target = self._q.copy()
        self._now = clock()
        self._inside = False
        self._puts = 0

    @override
    def __enter__(self) -> Self:
        self._now = self._clock()
        self._inside = True
        return self

    @override
    def __exit__(
        self,
        kind: type[BaseException] | None,
        error: BaseException | None,
        trace: TracebackType | None,
    ) -> None:
        self._advance()
        self._target = self._q.copy()
        self._inside = False

    @override
    def measured(self) -> tuple[Float, Float] | None:
        if not self._inside:
            return None
        self._advance()
        return self._q.copy(), (self._target - self._q) / self._lag

    @override
    def put(self, q: Float, qd: Float) -> None:
        self._advance()
        self._target = np.array(q, dtype=np.float64)
        self._puts += 1

    @override
    def health(self) -> Mapping[str, float]:
        return {"connected": float(self._inside), "puts": float(self._puts)}

    def _advance(self) -> None:
        now = self._clock()
        left = np.exp(-max(now - self._now, 0.0) / self._lag)
        self._q = self._target + (self._q - self._target) * left
        self._now = now
