"""Connected surfaces of a depth picture, and which of them lie apart from the main one."""

from __future__ import annotations

import numpy as np
from numba import njit
from numpy.typing import NDArray

from clothrf_how.foreground_kernels import GAP, stepped

# Pixels across which pieces are compared that meet nowhere: something in front may part the cloth.
FAR = 80
# Metres a pixel by which cloth may recede behind what parts it: 45 degrees at 0.7 m.
SLOPE = 0.002


@njit(cache=True, nogil=True)
def _root(parent: NDArray[np.int32], a: int) -> int:
    while parent[a] != a:
        parent[a] = parent[parent[a]]
        a = parent[a]
    return a


@njit(cache=True, nogil=True)
def _cut(
    y: int,
    row: NDArray[np.float32],
    state: NDArray[np.uint8],
    limit: np.float32,
    wanted: np.uint8,
    x0: int,
    x1: int,
    runs: NDArray[np.int32],
    parent: NDArray[np.int32],
    count: int,
    linked: NDArray[np.uint8],
) -> int:
    """Append the runs of one row; how many there are then. `linked` is (w,) scratch."""
    some = np.uint8(0)
    for x in range(x0, x1):
        some |= np.uint8(state[x] == wanted)
    if some == 0:
        return count
    linked[x0] = np.uint8(0)
    here, before, kind, left = row[x0 + 1 : x1], row[x0 : x1 - 1], state[x0 + 1 : x1], state[x0:x1]
    link = linked[x0 + 1 : x1]
    for i in range(x1 - x0 - 1):
        near = abs(here[i] - before[i]) < limit
        link[i] = np.uint8(near & (kind[i] == wanted) & (left[i] == wanted))
    x = x0
    while x < x1:
        while x < x1 and state[x] != wanted:
            x += 1
        if x == x1:
            break
        runs[count, 0], runs[count, 1] = y, x
        parent[count] = count
        x += 1
        while x < x1 and linked[x]:
            x += 1
        runs[count, 2] = x
        count += 1
    return count


# Runs of pixels instead of pixels: 72 us instead of 134 for a cloth on a third of 320 x 240; a
# picture of a roll-out takes 120 to 270.
@njit(cache=True, nogil=True)
def surfaces(
    z: NDArray[np.float32],
    state: NDArray[np.uint8],
    jump: float,
    wanted: int,
    box: tuple[int, int, int, int],
) -> tuple[NDArray[np.int32], NDArray[np.int32]]:
    """Connected surfaces: 4-neighbours in state `wanted` and closer than `jump` in depth.

    Every row is cut into runs; runs of neighbouring rows that meet are joined by union-find
    (Rosenfeld and Pfaltz 1966; He et al. 2008 for the runs).

    Args:
        z: (h, w) float32 depth, metres.
        state: (h, w) uint8.
        jump: metres.
        wanted: the state looked for.
        box: half-open (x0, y0, x1, y1) outside which nothing is in that state.

    Returns:
        (h, w) int32 label, 0 = none, numbered from 1 by first pixel in reading order; and the
        area in pixels of each label, (labels + 1,) int32.
    """
    x0, y0, x1, y1 = box
    label = np.zeros(z.shape, np.int32)
    limit = np.float32(jump)
    kind = np.uint8(wanted)
    # Row, first and one past the last column of each run; parents for the union-find.
    runs = np.empty((max(64, 4 * (y1 - y0)), 3), np.int32)
    parent = np.empty(len(runs), np.int32)
    linked = np.empty(z.shape[1], np.uint8)
    count = 0
    above = upper = 0
    for y in range(y0, y1):
        if count + x1 - x0 >= len(runs):
            size = 2 * (count + x1 - x0) + 64
            more, parents = np.empty((size, 3), np.int32), np.empty(size, np.int32)
            more[:count], parents[:count] = runs[:count], parent[:count]
            runs, parent = more, parents
        row, first = z[y], count
        count = _cut(y, row, state[y], limit, kind, x0, x1, runs, parent, count, linked)
        # Runs above and here, both from left to right.
        k = above
        for n in range(first, count):
            start, end = runs[n, 1], runs[n, 2]
            while k < upper and runs[k, 2] <= start:
                k += 1
            m = k
            while m < upper and runs[m, 1] < end:
                for i in range(max(start, runs[m, 1]), min(end, runs[m, 2])):
                    if abs(row[i] - z[y - 1, i]) < limit:
                        a, b = _root(parent, n), _root(parent, m)
                        parent[max(a, b)] = min(a, b)
                        break
                m += 1
        above, upper = first, count
    number = 0
    area = np.zeros(count + 1, np.int32)
    final = np.zeros(count, np.int32)
    for n in range(count):
        r = _root(parent, n)
        if r == n:
            number += 1
            final[n] = number
        else:
            final[n] = final[r]
        start, end = runs[n, 1], runs[n, 2]
        label[runs[n, 0], start:end] = final[n]
        area[final[n]] += end - start
    return label, area[: number + 1].copy()


@njit(cache=True, nogil=True)
def apart(
    label: NDArray[np.int32],
    area: NDArray[np.int32],
    z: NDArray[np.float32],
    main: int,
    least: int,
    jump: float,
    box: tuple[int, int, int, int],
) -> NDArray[np.int64]:
    """(labels, 2): how often each piece is `jump` from `main` in depth, and meets it at all.

    They meet where a pixel of a piece of at least `least` pixels and one of `main` are at most
    `GAP` apart in a row or a column; a piece that meets it nowhere is looked at again, up to `FAR`
    pixels away: behind something in front the cloth may recede by `SLOPE`, past the background it
    must go on at its depth, give or take half of `jump`. One that meets it not even there counts as
    apart if it is nearer than all of `main` by half of `jump`. No piece lies outside the half-open
    `box`.
    """
    count = np.zeros((area.size, 2), np.int64)
    _meet(label, area, z, main, least, jump, box, GAP, count)
    alone = False
    for n in range(1, area.size):
        alone |= n != main and area[n] >= least and count[n, 1] == 0
    if alone:
        again = np.zeros((area.size, 2), np.int64)
        _meet(label, area, z, main, least, jump, box, FAR, again)
        near = _nearest(label, z, area.size, box)
        for n in range(area.size):
            if count[n, 1] == 0:
                count[n] = again[n]
            if count[n, 1] == 0 and near[n] < near[main] - 0.5 * jump:
                count[n] = 1
    return count


@njit(cache=True, nogil=True)
def _nearest(
    label: NDArray[np.int32], z: NDArray[np.float32], labels: int, box: tuple[int, int, int, int]
) -> NDArray[np.float32]:
    """(labels,) float32 least depth of each piece, metres; infinite for 0 and for empty ones."""
    x0, y0, x1, y1 = box
    least = np.full(labels, np.inf, np.float32)
    for y in range(y0, y1):
        for x in range(x0, x1):
            n = label[y, x]
            if n > 0:
                least[n] = min(least[n], z[y, x])
    return least


@njit(cache=True, nogil=True)
def _meet(
    label: NDArray[np.int32],
    area: NDArray[np.int32],
    z: NDArray[np.float32],
    main: int,
    least: int,
    jump: float,
    box: tuple[int, int, int, int],
    reach: int,
    count: NDArray[np.int64],
) -> None:
    """Add to `count` what is met within `reach` pixels."""
    h, w = label.shape
    x0, y0, x1, y1 = box
    for y in range(y0, y1):
        for x in range(x0, x1):
            n = label[y, x]
            if n == 0 or n == main or area[n] < least:
                continue
            for k in range(4):
                behind = 0
                for step in range(1, reach + 1):
                    j, i = stepped(y, x, k, step)
                    if not (0 <= j < h and 0 <= i < w):
                        break
                    if label[j, i] == main:
                        allowed = jump + SLOPE * max(step - GAP, 0)
                        if behind > GAP:
                            allowed = 0.5 * jump
                        count[n, 1] += 1
                        if abs(z[j, i] - z[y, x]) > allowed:
                            count[n, 0] += 1
                        break
                    behind += z[j, i] <= 0.0 or z[j, i] > z[y, x] + jump
