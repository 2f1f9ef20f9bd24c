"""How far each pixel is from a depth edge: the border of missing depth, or a jump."""

from __future__ import annotations

from typing import Any, NamedTuple

import numpy as np
from numba import njit

from clothrf_core.types import Float32

# Distances are cut here, pixels; beyond, drop-outs no longer depend on them.
REACH = 16
FAR2 = (REACH + 1) ** 2


class Window(NamedTuple):
    """Rows [top, bottom) and columns [left, right) that hold all measured pixels."""

    top: int
    bottom: int
    left: int
    right: int


@njit(cache=True, nogil=True)
def measured_window(depth: Any, margin: int) -> Any:
    """(top, bottom, left, right) of all finite pixels, widened by `margin`; empty if none."""
    height, width = depth.shape
    top, bottom, left, right = height, -1, width, -1
    for y in range(height):
        first = width
        for x in range(width):
            if depth[y, x] == depth[y, x]:
                first = x
                break
        if first == width:
            continue
        last = first
        for x in range(width - 1, first, -1):
            if depth[y, x] == depth[y, x]:
                last = x
                break
        if top == height:
            top = y
        bottom = y
        left = min(left, first)
        right = max(right, last)
    if bottom < 0:
        return 0, 0, 0, 0
    return (
        max(0, top - margin),
        min(height, bottom + 1 + margin),
        max(0, left - margin),
        min(width, right + 1 + margin),
    )


def edge_distance2(depth: Float32, window: Window, *, jump: float) -> Float32:
    """(h, w) float32 squared distance in pixels to the nearest edge pixel, at most `FAR2`.

    Edge pixels (0) are those with a 4-neighbour that differs in being measured, or whose depth
    differs by more than `jump` metres; both sides count. The border of the window is no edge.
    Exact Euclidean distance by columns and then rows (Felzenszwalb, Huttenlocher 2012), cut at
    `REACH` so that the row step is a short loop that vectorises.
    """
    result: Float32 = _edge_distance2(depth, np.float32(jump), *window)
    return result


@njit(cache=True, nogil=True)
def _edge_distance2(depth: Any, jump: Any, top: int, bottom: int, left: int, right: int) -> Any:
    h, w = bottom - top, right - left
    zero, one, far = np.float32(0.0), np.float32(1.0), np.float32(REACH + 1)
    # Missing depth as 0, with a border that repeats the outermost pixels: the loops below need
    # neither bounds nor branches and vectorise.
    clean = np.zeros((h + 2, w + 2), np.float32)
    for r in range(h):
        source, target = depth[top + r, left:right], clean[r + 1, 1 : w + 1]
        for c in range(w):
            z = source[c]
            target[c] = z if z == z else zero
        clean[r + 1, 0] = clean[r + 1, 1]
        clean[r + 1, w + 1] = clean[r + 1, w]
    clean[0] = clean[1]
    clean[h + 1] = clean[h]
    column = np.full((h, w + 2 * REACH), far, np.float32)
    for r in range(h):
        above, below = clean[r, 1 : w + 1], clean[r + 2, 1 : w + 1]
        before, here, after = clean[r + 1, :w], clean[r + 1, 1 : w + 1], clean[r + 1, 2:]
        target = column[r, REACH : REACH + w]
        for c in range(w):
            z = here[c]
            vertical = abs(above[c] - z) > jump or abs(below[c] - z) > jump
            level = abs(before[c] - z) > jump or abs(after[c] - z) > jump
            target[c] = zero if vertical or level else far
    for r in range(1, h):
        mine, other = column[r], column[r - 1]
        for c in range(w + 2 * REACH):
            step = other[c] + one
            mine[c] = step if step < mine[c] else mine[c]
    for r in range(h - 2, -1, -1):
        mine, other = column[r], column[r + 1]
        for c in range(w + 2 * REACH):
            step = other[c] + one
            mine[c] = step if step < mine[c] else mine[c]
    out = np.empty((h, w), np.float32)
    square = np.empty(w + 2 * REACH, np.float32)
    for r in range(h):
        mine, result = column[r], out[r]
        for c in range(w + 2 * REACH):
            square[c] = mine[c] * mine[c]
        for c in range(w):
            best = square[REACH + c]
            for k in range(1, REACH + 1):
                sooner, later = square[REACH + c - k], square[REACH + c + k]
                near = (sooner if sooner < later else later) + np.float32(k * k)
                best = near if near < best else best
            result[c] = best
    return out
