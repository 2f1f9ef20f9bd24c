"""Connected surfaces of a depth picture, and which of them lie apart from the main one."""

from __future__ import annotations

import numpy as np
from numba import njit
from numpy.typing import NDArray

from clothrf_how.foreground_kernels import GAP


@njit(cache=True, nogil=True)
def _root(parent: NDArray[np.int32], a: int) -> int:
    while parent[a] != a:
        parent[a] = parent[parent[a]]
        a = parent[a]
    return a


@njit(cache=True, nogil=True)
def surfaces(
    z: NDArray[np.float32], state: NDArray[np.uint8], jump: float, wanted: int
) -> tuple[NDArray[np.int32], NDArray[np.int32]]:
    """Connected surfaces: 4-neighbours in state `wanted` and closer than `jump` in depth.

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
            if state[y, x] != wanted:
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
def apart(
    label: NDArray[np.int32],
    area: NDArray[np.int32],
    z: NDArray[np.float32],
    main: int,
    least: int,
    jump: float,
) -> NDArray[np.int64]:
    """(labels, 2): how often each piece is `jump` from `main` in depth, and meets it at all.

    They meet where a pixel of a piece of at least `least` pixels and one of `main` are at most
    `GAP` apart in a row or a column.
    """
    h, w = label.shape
    count = np.zeros((area.size, 2), np.int64)
    for y in range(h):
        for x in range(w):
            n = label[y, x]
            if n == 0 or n == main or area[n] < least:
                continue
            for k in range(4):
                for step in range(1, GAP + 1):
                    j = y + (step if k == 0 else (-step if k == 1 else 0))
                    i = x + (step if k == 2 else (-step if k == 3 else 0))
                    if not (0 <= j < h and 0 <= i < w):
                        break
                    if label[j, i] == main:
                        count[n, 1] += 1
                        if abs(z[j, i] - z[y, x]) > jump:
                            count[n, 0] += 1
                        break
    return count
