"""The cloth's surface as a small grid of points: block means over the foreground's box."""

from __future__ import annotations

import numpy as np
from numba import njit
from numpy.typing import NDArray

from clothrf_core.types import Float32
from clothrf_how.cloud import Cloud

GRIDS = (2, 4, 8)


def blocks_names() -> tuple[str, ...]:
    """x, y, z and share of pixels of each block of 2 x 2, 4 x 4 and 8 x 8 blocks."""
    return tuple(
        f"blocks_{n}_{a}_{j}{i}"
        for n in GRIDS
        for a in (*"xyz", "n")
        for j in range(n)
        for i in range(n)
    )


def blocks(cloud: Cloud) -> Float32:
    """(336,) float32; metres from the anchor; an empty block has zeros."""
    finest = block_sums(cloud.points, cloud.mask, GRIDS[-1])
    parts = []
    for n in GRIDS:
        k = GRIDS[-1] // n
        sums = finest.reshape(4, n, k, n, k).sum(axis=(2, 4))
        means = sums[:3] / np.maximum(sums[3], 1.0)
        parts += [means.ravel(), (sums[3] * (n * n) / cloud.mask.size).ravel()]
    return np.concatenate(parts).astype(np.float32)


@njit(cache=True, nogil=True)
def block_sums(points: NDArray[np.float32], mask: NDArray[np.bool_], n: int) -> NDArray[np.float64]:
    """(4, n, n) sums of x, y, z and the number of points of n x n blocks of the box."""
    _, h, w = points.shape
    sums = np.zeros((4, n, n))
    for y in range(h):
        j = y * n // h
        for i in range(n):
            start, end = (i * w + n - 1) // n, ((i + 1) * w + n - 1) // n
            sx = sy = sz = np.float32(0.0)
            count = 0
            for x in range(start, end):
                sx += points[0, y, x]
                sy += points[1, y, x]
                sz += points[2, y, x]
                count += 1 if mask[y, x] else 0
            sums[0, j, i] += sx
            sums[1, j, i] += sy
            sums[2, j, i] += sz
            sums[3, j, i] += count
    return sums
