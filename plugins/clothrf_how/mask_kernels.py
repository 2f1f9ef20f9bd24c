"""What is done to a foreground mask: its bounds, its holes bridged, its sums."""

from __future__ import annotations

import numpy as np
from numba import njit
from numpy.typing import NDArray


@njit(cache=True, nogil=True)
def ends(row: NDArray[np.bool_], start: int, stop: int) -> tuple[int, int]:
    """Half-open range of a row from its first to its last true pixel; empty if there is none."""
    a, b = start, stop
    while a < stop and not row[a]:
        a += 1
    while b > a and not row[b - 1]:
        b -= 1
    return a, b


@njit(cache=True, nogil=True)
def bounds(mask: NDArray[np.bool_], box: tuple[int, int, int, int]) -> tuple[int, int, int, int]:
    """Half-open (x0, y0, x1, y1) of the true pixels, all of which lie in `box`; zeros if none."""
    left, top, right, bottom = box
    x0, y0, x1, y1 = right, bottom, left, top
    for y in range(top, bottom):
        first, end = ends(mask[y], left, right)
        if first == end:
            continue
        x0, x1 = min(x0, first), max(x1, end)
        y0, y1 = min(y0, y), y + 1
    return (x0, y0, x1, y1) if x1 > x0 else (0, 0, 0, 0)


@njit(cache=True, nogil=True)
def _across(
    z: NDArray[np.float32],
    depth: NDArray[np.float32],
    y: int,
    x: int,
    dy: int,
    dx: int,
    n: int,
    limit: np.float32,
    full: NDArray[np.bool_],
) -> None:
    """Fill the n pixels before (y, x), going back by (dy, dx), unless one looks past the cloth."""
    a = depth[y - (n + 1) * dy, x - (n + 1) * dx]
    rise = depth[y, x] - a
    if abs(rise) > limit:
        return
    slope = rise / np.float32(n + 1)
    for i in range(1, n + 1):
        k = n + 1 - i
        if z[y - k * dy, x - k * dx] > a + slope * np.float32(i) + limit:
            return
    for i in range(1, n + 1):
        k = n + 1 - i
        full[y - k * dy, x - k * dx] = True
        depth[y - k * dy, x - k * dx] = a + slope * np.float32(i)


@njit(cache=True, nogil=True)
def replace_known(
    z: NDArray[np.float32], by: NDArray[np.float32], box: tuple[int, int, int, int]
) -> None:
    """Write (h, w) `by` over `z`, in place, within the half-open `box` where both are positive."""
    x0, y0, x1, y1 = box
    zero = np.float32(0.0)
    for y in range(y0, y1):
        row, new = z[y, x0:x1], by[y, x0:x1]
        for i in range(x1 - x0):
            row[i] = new[i] if (row[i] > zero) & (new[i] > zero) else row[i]


# Rows and columns without a hole are left alone: 42 us instead of 125 a frame.
@njit(cache=True, nogil=True)
def bridge(
    label: NDArray[np.int32],
    kept: NDArray[np.int32],
    z: NDArray[np.float32],
    gap: int,
    jump: float,
    box: tuple[int, int, int, int],
) -> tuple[NDArray[np.bool_], NDArray[np.float32]]:
    """The pieces that are kept, with holes of up to `gap` pixels filled along rows, then columns.

    A run of pixels between two foreground pixels is filled by linear interpolation unless
    something is measured `jump` behind it there: then one really looks past the cloth.

    Args:
        label: (h, w) int32 pieces.
        kept: (K,) int32, the pieces that are kept.
        z: (h, w) float32 metres, 0 = not measured.
        gap: pixels.
        jump: metres.
        box: half-open (x0, y0, x1, y1) outside which nothing is labelled.

    Returns:
        (h, w) bool; (h, w) float32 metres, 0 outside the mask.
    """
    h, w = label.shape
    mask = np.zeros((h, w), np.bool_)
    depth = np.zeros((h, w), np.float32)
    zero = np.float32(0.0)
    x0, y0, x1, y1 = box
    limit = np.float32(jump)
    for y in range(y0, y1):
        row, inside, line = z[y, x0:x1], mask[y, x0:x1], depth[y, x0:x1]
        piece = label[y, x0:x1]
        for n in range(kept.size):
            number = kept[n]
            for i in range(x1 - x0):
                inside[i] |= piece[i] == number
        many = np.int32(0)
        for i in range(x1 - x0):
            line[i] = row[i] if inside[i] else zero
            many += np.int32(1) if inside[i] else np.int32(0)
        a, b = ends(mask[y], x0, x1)
        if many == b - a:
            continue
        last = w
        for x in range(a, b):
            if mask[y, x]:
                n = x - last - 1
                if 0 < n <= gap:
                    _across(z, depth, y, x, 0, 1, n, limit, mask)
                last = x
    top = np.full(x1 - x0, h, np.int32)
    low = np.full(x1 - x0, -1, np.int32)
    number = np.zeros(x1 - x0, np.int32)
    for y in range(y0, y1):
        inside, here = mask[y, x0:x1], np.int32(y)
        for i in range(x1 - x0):
            one = inside[i]
            top[i] = here if one & (here < top[i]) else top[i]
            low[i] = here if one else low[i]
            number[i] += np.int32(1) if one else np.int32(0)
    for i in range(x1 - x0):
        if number[i] == low[i] - top[i] + 1 or number[i] == 0:
            continue
        x = x0 + i
        last = h
        for y in range(top[i], low[i] + 1):
            if mask[y, x]:
                n = y - last - 1
                if 0 < n <= gap:
                    _across(z, depth, y, x, 1, 0, n, limit, mask)
                last = y
    return mask, depth


# Sums of a row may be added in any order: vector code.
@njit(cache=True, nogil=True, fastmath={"contract", "reassoc", "nsz"})
def sums(
    mask: NDArray[np.bool_], depth: NDArray[np.float32], box: tuple[int, int, int, int]
) -> tuple[int, float, float, float]:
    """Pixels of a mask, and the sums of their columns, rows and depths; depth is 0 outside."""
    x0, y0, x1, y1 = box
    area = 0
    u = v = z = 0.0
    for y in range(y0, y1):
        inside, row = mask[y, x0:x1], depth[y, x0:x1]
        count = np.int32(0)
        columns = np.int32(0)
        total = np.float32(0.0)
        for i in range(x1 - x0):
            one = np.int32(1) if inside[i] else np.int32(0)
            count += one
            columns += one * np.int32(i)
            total += row[i]
        area += int(count)
        u += float(columns) + x0 * float(count)
        v += y * float(count)
        z += float(total)
    return area, u, v, z
