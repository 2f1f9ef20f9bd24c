"""Compiled loops of the foreground: block reduction, connected surfaces, bridged holes."""

from __future__ import annotations

from typing import Any

import numpy as np
from numba import njit
from numpy.typing import NDArray

# States of a working pixel.
UNMEASURED = 0
CANDIDATE = 1
ELSEWHERE = 2

# Depths of one 2 x 2 block that are this close to its nearest are averaged, metres; across an edge
# the mean of near and far would be a point in the air.
BLOCK = np.float32(0.015)


@njit(cache=True, nogil=True)
def reduce_blocks(
    depth: NDArray[np.float32],
    factor: int,
    near: float,
    far: float,
    directions: NDArray[np.float32],
    origin: NDArray[np.float32],
    low: NDArray[np.float32],
    high: NDArray[np.float32],
) -> tuple[NDArray[np.float32], NDArray[np.uint8]]:
    """Depth (h, w) of factor x factor blocks, 0 = not measured, and the state of each block.

    A block's depth is the mean of its depths that are within `BLOCK` of the nearest one in
    [near, far]; it is a candidate if its world point ``origin + depth * direction`` lies in
    the box.

    Args:
        depth: (H, W) float32, metres; NaN, infinite, zero and negative = not measured.
        factor: pixels along a block's side.
        near: least depth, metres.
        far: largest depth, metres.
        directions: (3, h, w) float32 world direction of each block's ray, of unit depth.
        origin: (3,) camera centre, world.
        low: (3,) corner of the workspace box, world.
        high: (3,) the opposite corner.
    """
    _, h, w = directions.shape
    z = np.zeros((h, w), np.float32)
    state = np.zeros((h, w), np.uint8)
    lowest = np.float32(near)
    highest = np.float32(far)
    nothing = np.float32(np.inf)
    for y in range(h):
        for x in range(w):
            nearest = nothing
            outside = np.float32(0.0)
            for j in range(factor):
                for i in range(factor):
                    d = depth[y * factor + j, x * factor + i]
                    if lowest <= d <= highest:
                        nearest = min(nearest, d)
                    elif np.float32(0.0) < d < nothing:
                        outside = d
            if nearest == nothing:
                if outside > np.float32(0.0):
                    z[y, x] = outside
                    state[y, x] = ELSEWHERE
                continue
            total = np.float32(0.0)
            count = np.float32(0.0)
            limit = min(nearest + BLOCK, highest)
            for j in range(factor):
                for i in range(factor):
                    d = depth[y * factor + j, x * factor + i]
                    if nearest <= d <= limit:
                        total += d
                        count += np.float32(1.0)
            d = total / count
            z[y, x] = d
            px = origin[0] + d * directions[0, y, x]
            py = origin[1] + d * directions[1, y, x]
            pz = origin[2] + d * directions[2, y, x]
            inside = low[0] <= px <= high[0] and low[1] <= py <= high[1] and low[2] <= pz <= high[2]
            state[y, x] = CANDIDATE if inside else ELSEWHERE
    return z, state


@njit(cache=True, nogil=True)
def _root(parent: NDArray[np.int32], a: int) -> int:
    while parent[a] != a:
        parent[a] = parent[parent[a]]
        a = parent[a]
    return a


@njit(cache=True, nogil=True)
def surfaces(
    z: NDArray[np.float32], state: NDArray[np.uint8], jump: float
) -> tuple[NDArray[np.int32], NDArray[np.int32]]:
    """Connected surfaces: 4-neighbours that are candidates and closer than `jump` in depth.

    Two passes with union-find (Rosenfeld and Pfaltz 1966).

    Returns:
        (h, w) int32 label, 0 = none, numbered from 1 by first pixel in reading order; and the
        area in pixels of each label, (labels + 1,) int32.
    """
    h, w = z.shape
    label = np.zeros((h, w), np.int32)
    parent = np.zeros(h * w // 2 + 2, np.int32)
    limit = np.float32(jump)
    fresh = 1
    for y in range(h):
        for x in range(w):
            if state[y, x] != CANDIDATE:
                continue
            d = z[y, x]
            left = 0
            if x > 0 and label[y, x - 1] > 0 and abs(d - z[y, x - 1]) < limit:
                left = label[y, x - 1]
            up = 0
            if y > 0 and label[y - 1, x] > 0 and abs(d - z[y - 1, x]) < limit:
                up = label[y - 1, x]
            if left == 0 and up == 0:
                if fresh == parent.size:
                    grown = np.zeros(2 * parent.size, np.int32)
                    grown[: parent.size] = parent
                    parent = grown
                parent[fresh] = fresh
                label[y, x] = fresh
                fresh += 1
            elif left == 0 or left == up:
                label[y, x] = up
            elif up == 0:
                label[y, x] = left
            else:
                a = _root(parent, left)
                b = _root(parent, up)
                label[y, x] = min(a, b)
                parent[max(a, b)] = min(a, b)
    final = np.zeros(fresh, np.int32)
    number = 0
    for a in range(1, fresh):
        r = _root(parent, a)
        if r == a:
            number += 1
            final[a] = number
        else:
            final[a] = final[r]
    area = np.zeros(number + 1, np.int32)
    for y in range(h):
        for x in range(w):
            if label[y, x] > 0:
                n = final[label[y, x]]
                label[y, x] = n
                area[n] += 1
    return label, area


@njit(cache=True, nogil=True)
def bridge(
    mask: NDArray[np.bool_], z: NDArray[np.float32], gap: int, jump: float
) -> tuple[NDArray[np.bool_], NDArray[np.float32]]:
    """Mask and depth with holes of up to `gap` pixels filled along rows, then along columns.

    A run of pixels between two foreground pixels is filled by linear interpolation unless
    something is measured `jump` behind it there: then one really looks past the cloth.

    Returns:
        (h, w) bool; (h, w) float32 metres, 0 outside the mask.
    """
    h, w = mask.shape
    full = mask.copy()
    depth = np.zeros((h, w), np.float32)
    for y in range(h):
        for x in range(w):
            if mask[y, x]:
                depth[y, x] = z[y, x]
    limit = np.float32(jump)
    for y in range(h):
        last = -1
        for x in range(w):
            if mask[y, x]:
                n = x - last - 1
                if last >= 0 and 0 < n <= gap:
                    a = depth[y, last]
                    slope = (depth[y, x] - a) / np.float32(n + 1)
                    through = abs(slope) * np.float32(n + 1) > limit
                    for i in range(1, n + 1):
                        through = through or z[y, last + i] > a + slope * np.float32(i) + limit
                    if not through:
                        for i in range(1, n + 1):
                            full[y, last + i] = True
                            depth[y, last + i] = a + slope * np.float32(i)
                last = x
    rows = full.copy()
    last_row = np.full(w, -1, np.int32)
    for y in range(h):
        for x in range(w):
            if rows[y, x]:
                last = last_row[x]
                n = y - last - 1
                if last >= 0 and 0 < n <= gap:
                    a = depth[last, x]
                    slope = (depth[y, x] - a) / np.float32(n + 1)
                    through = abs(slope) * np.float32(n + 1) > limit
                    for i in range(1, n + 1):
                        through = through or z[last + i, x] > a + slope * np.float32(i) + limit
                    if not through:
                        for i in range(1, n + 1):
                            full[last + i, x] = True
                            depth[last + i, x] = a + slope * np.float32(i)
                last_row[x] = y
    return full, depth


def warm() -> Any:
    """Compile (or load from the cache) every kernel, so that the first frame is not late."""
    one = np.zeros((2, 2), np.float32)
    ends = np.zeros(3, np.float32)
    z, state = reduce_blocks(one, 1, 0.1, 1.0, np.zeros((3, 2, 2), np.float32), ends, ends, ends)
    surfaces(z, state, 0.1)
    return bridge(state > 0, z, 1, 0.1)
