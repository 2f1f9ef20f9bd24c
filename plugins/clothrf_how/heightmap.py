"""A coarse map of the cloth's height around the anchor, in metres, seen from above."""

from __future__ import annotations

import numpy as np
from numba import njit
from numpy.typing import NDArray

from clothrf_core.types import Float32
from clothrf_how.cloud import Cloud

CELLS = 8
SIDE = 0.40


def heightmap_names() -> tuple[str, ...]:
    """Mean height above the anchor, and share of the points, of 8 x 8 cells of 5 cm."""
    cells = [f"{i}{j}" for i in range(CELLS) for j in range(CELLS)]
    return (*(f"heightmap_z_{c}" for c in cells), *(f"heightmap_n_{c}" for c in cells))


def heightmap(cloud: Cloud) -> Float32:
    """(128,) float32; i runs along world x, j along world y; empty cells have height 0."""
    height, share = binned(cloud.points, cloud.mask, CELLS, SIDE)
    return np.concatenate([height.ravel(), share.ravel()]).astype(np.float32)


@njit(cache=True, nogil=True)
def binned(
    points: NDArray[np.float32], mask: NDArray[np.bool_], cells: int, side: float
) -> tuple[NDArray[np.float64], NDArray[np.float64]]:
    """(cells, cells) mean z and share of the points."""
    _, h, w = points.shape
    height = np.zeros((cells, cells))
    count = np.zeros((cells, cells))
    scale = np.float32(cells / side)
    middle = np.float32(0.5 * cells)
    total = 0
    for y in range(h):
        for x in range(w):
            if mask[y, x]:
                total += 1
                i = int(np.floor(points[0, y, x] * scale + middle))
                j = int(np.floor(points[1, y, x] * scale + middle))
                if 0 <= i < cells and 0 <= j < cells:
                    height[i, j] += points[2, y, x]
                    count[i, j] += 1.0
    for i in range(cells):
        for j in range(cells):
            if count[i, j] > 0.0:
                height[i, j] /= count[i, j]
    return height, count / max(total, 1)
