"""How noisy a depth picture is, and what calms one that is: compiled loops."""

from __future__ import annotations

import numpy as np
from numba import njit
from numpy.typing import NDArray

from clothrf_how.histogram import median_bin

# A second difference of three independent normal errors has this many of their deviations, and the
# median of its magnitude is 0.6745 of its own.
SPREAD = 0.6745 * 6.0**0.5
# Bins of a millimetre of second differences; larger ones are edges.
STEP = 1e-3
BINS = 400
# Every so many rows are looked at.
EVERY = 16


@njit(cache=True, nogil=True)
def noise(depth: NDArray[np.float32], near: float, far: float) -> float:
    """Standard deviation of a pixel's depth about its neighbours, metres.

    From the median magnitude of second differences along every sixteenth row (a slope has none, an
    edge is rare), as Immerkaer (1996) does with a Laplacian; 0 where less than a hundred are known.

    Args:
        depth: (H, W) float32, metres.
        near: least depth looked at, metres.
        far: largest.
    """
    count = np.zeros(BINS, np.int64)
    lo, hi = np.float32(near), np.float32(far)
    per = np.float32(1.0 / STEP)
    last = np.float32(BINS - 1)
    h, w = depth.shape
    known = 0
    for y in range(0, h, EVERY):
        row = depth[y]
        for x in range(1, w - 1, 2):
            a, b, c = row[x - 1], row[x], row[x + 1]
            if (a >= lo) & (a <= hi) & (b >= lo) & (b <= hi) & (c >= lo) & (c <= hi):
                count[int(min(abs(a - b - b + c) * per, last))] += 1
                known += 1
    if known < 100:
        return 0.0
    return STEP * median_bin(count, known) / SPREAD


@njit(cache=True, nogil=True)
def calmed(
    depth: NDArray[np.float32],
    mask: NDArray[np.bool_],
    radius: int,
    box: tuple[int, int, int, int],
) -> NDArray[np.float32]:
    """(h, w) float32: the mean of what of the mask lies within `radius` rows and columns.

    Args:
        depth: (h, w) float32 metres, 0 outside the mask.
        mask: (h, w) bool.
        radius: pixels.
        box: half-open (x0, y0, x1, y1) that holds the mask.
    """
    h, w = mask.shape
    x0, y0, x1, y1 = box
    wide = x1 - x0
    total = np.zeros((y1 - y0 + 1, wide + 1))
    many = np.zeros((y1 - y0 + 1, wide + 1), np.int32)
    for y in range(y1 - y0):
        row = 0.0
        number = 0
        for x in range(wide):
            if mask[y0 + y, x0 + x]:
                row += depth[y0 + y, x0 + x]
                number += 1
            total[y + 1, x + 1] = total[y, x + 1] + row
            many[y + 1, x + 1] = many[y, x + 1] + number
    result = np.zeros((h, w), np.float32)
    for y in range(y1 - y0):
        a, b = max(y - radius, 0), min(y + radius + 1, y1 - y0)
        for x in range(wide):
            if not mask[y0 + y, x0 + x]:
                continue
            c, d = max(x - radius, 0), min(x + radius + 1, wide)
            number = many[b, d] - many[a, d] - many[b, c] + many[a, c]
            value = total[b, d] - total[a, d] - total[b, c] + total[a, c]
            result[y0 + y, x0 + x] = value / number
    return result
