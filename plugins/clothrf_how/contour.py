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
from clothrf_how.mask_kernels import ends

BANDS = 8
SIDES = ("top", "bottom", "left", "right")


def contour_names() -> tuple[str, ...]:
    """96 names; band 0 is leftmost (top, bottom) or uppermost (left, right)."""
    return tuple(f"contour_{s}_{b}_{a}" for s in SIDES for b in range(BANDS) for a in "xyz")


def contour(cloud: Cloud) -> Float32:
    """(96,) float32 metres from the anchor."""
    first, last = rims(cloud.mask)
    rows = outline(cloud.points, first, last, BANDS)
    first, last = rims_down(cloud.mask)
    columns = outline(cloud.points.transpose(0, 2, 1), first, last, BANDS)
    return np.concatenate([columns.ravel(), rows.ravel()]).astype(np.float32)


@njit(cache=True, nogil=True)
def rims(mask: NDArray[np.bool_]) -> tuple[NDArray[np.int32], NDArray[np.int32]]:
    """(h,) int32 column of the first and of the last pixel of each row; -1 = none."""
    h, w = mask.shape
    first, last = np.full(h, -1, np.int32), np.full(h, -1, np.int32)
    for y in range(h):
        a, b = ends(mask[y], 0, w)
        if a < b:
            first[y], last[y] = a, b - 1
    return first, last


@njit(cache=True, nogil=True)
def rims_down(mask: NDArray[np.bool_]) -> tuple[NDArray[np.int32], NDArray[np.int32]]:
    """(w,) int32 row of the first and of the last pixel of each column; -1 = none."""
    h, w = mask.shape
    first, last = np.full(w, -1, np.int32), np.full(w, -1, np.int32)
    # Row by row, for the sake of vector code.
    for y in range(h):
        inside, here = mask[y], np.int32(y)
        for x in range(w):
            first[x] = here if inside[x] & (first[x] < 0) else first[x]
            last[x] = here if inside[x] else last[x]
    return first, last


@njit(cache=True, nogil=True)
def outline(
    points: NDArray[np.float32],
    first: NDArray[np.int32],
    last: NDArray[np.int32],
    bands: int,
) -> NDArray[np.float64]:
    """(2, bands, 3) mean of the first and of the last point of each row, over bands of rows.

    A band without any point takes its neighbour's.

    Args:
        points: (3, h, w) float32, in any memory order.
        first: (h,) int32 column of each row's first point, -1 = none.
        last: of its last.
        bands: number of bands.
    """
    total = np.zeros((2, bands, 3))
    count = np.zeros(bands)
    for n in range(first.size):
        a, b = first[n], last[n]
        if a < 0:
            continue
        band = n * bands // first.size
        count[band] += 1.0
        for axis in range(3):
            total[0, band, axis] += points[axis, n, a]
            total[1, band, axis] += points[axis, n, b]
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
