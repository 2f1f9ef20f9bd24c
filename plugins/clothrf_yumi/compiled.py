"""What the arm model does with plain arrays in every tick, compiled when the module is imported."""

from __future__ import annotations

import math
from typing import Any

from numba import njit

SAME, NEW = -1, -2


@njit("i8(f8[:, ::1], f8[:, ::1], f8[:, ::1], f8[::1])", cache=True, nogil=True)
def recall(bounds: Any, postures: Any, levers: Any, q: Any) -> Any:
    """The memory whose posture is nearest to `q`, brought there.

    Args:
        bounds: (M, P) what no distance of the P pairs is less than; that row is loosened.
        postures: (M, J) where each memory stands; that row becomes `q`.
        levers: (J, P) metres by which a radian of a joint can change each distance.
        q: (J,) posture, rad.
    """
    chosen, least = 0, math.inf
    for i in range(postures.shape[0]):
        far = 0.0
        for j in range(q.size):
            far = max(far, abs(q[j] - postures[i, j]))
        if far < least:
            chosen, least = i, far
    bound = bounds[chosen]
    for j in range(q.size):
        turned = abs(q[j] - postures[chosen, j])
        postures[chosen, j] = q[j]
        for k in range(bound.size):
            bound[k] -= levers[j, k] * turned
    return chosen


@njit("i8(f8[::1], f8[::1], f8[::1], f8[::1])", cache=True, nogil=True)
def settle(target: Any, low: Any, high: Any, wanted: Any) -> Any:
    """Make `wanted` (J,) the target within its limits; SAME, NEW, or a joint that is not finite."""
    for j in range(target.size):
        if not math.isfinite(target[j]):
            return j
    found = SAME
    for j in range(target.size):
        x = min(max(target[j], low[j]), high[j])
        if x != wanted[j]:
            wanted[j] = x
            found = NEW
    return found
