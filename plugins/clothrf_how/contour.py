"""The rim of the cloth, side by side: where its upper, lower, left and right outline runs.

The foreground's box is cut into bands; in each the outline's points are averaged, which tames the
noisy rim, and bands follow the cloth, so none is empty.
"""

from __future__ import annotations

import numpy as np
from numba import njit
from numpy.typing import NDArray

from clothrf_core.types import Float32
from clothrf_how.cloud import Cloud

BANDS = 8
SIDES = ("top", "bottom", "left", "right")


def contour_names() -> tuple[str, ...]:
    """96 names; band 0 is leftmost (top, bottom) or uppermost (left, right)."""
    return tuple(f"contour_{s}_{b}_{a}" for s in SIDES for b in range(BANDS) for a in "xyz")


def contour(cloud: Cloud) -> Float32:
    """(96,) float32 metres from the anchor."""
    rows = outline(cloud.points, cloud.mask, BANDS)
    columns = outline(
        np.ascontiguousarray(cloud.points.transpose(0, 2, 1)),
        np.ascontiguousarray(cloud.mask.T),
        BANDS,
    )
    return np.concatenate([columns.ravel(), rows.ravel()]).astype(np.float32)


@njit(cache=True, nogil=True)
def outline(
    points: NDArray[np.float32], mask: NDArray[np.bool_], bands: int
) -> NDArray[np.float64]:
    """(2, bands, 3) mean of the first and of the last point of each row, over bands of rows.

    A band without any point takes its neighbour's.
    """
    _, h, w = points.shape
    total = np.zeros((2, bands, 3))
    count = np.zeros(bands)
    for y in range(h):
        a = 0
        while a < w and not mask[y, a]:
            a += 1
        if a == w:
            continue
        b = w - 1
        while not mask[y, b]:
            b -= 1
        band = y * bands // h
        count[band] += 1.0
        for axis in range(3):
            total[0, band, axis] += points[axis, y, a]
            total[1, band, axis] += points[axis, y, b]
    for band in range(bands):
        if count[band] > 0.0:
            total[:, band] /= count[band]
    for band in range(1, bands):
        if count[band] == 0.0:
            total[:, band] = total[:, band - 1]
            count[band] = count[band - 1]
    for band in range(bands - 2, -1, -1):
        if count[band] == 0.0:
            total[:, band] = total[:, band + 1]
            count[band] = count[band + 1]
    return total
