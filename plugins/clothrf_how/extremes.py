"""Outermost points of the cloth in the picture: the corners of a held cloth are among them.

The support point of a direction is the pixel of the foreground that lies farthest that way. A
corner is the support point of a whole fan of directions, so a few directions find all four corners,
and a corner that is out of the picture is replaced by where the cloth leaves it.
"""

from __future__ import annotations

import math

import numpy as np
from numba import njit
from numpy.typing import NDArray

from clothrf_core.types import Float32
from clothrf_how.cloud import Cloud

COUNT = 16
# Points of all pixels this close to the outermost one are averaged, working pixels of a picture
# 320 wide: the rim of a depth picture is its noisiest part.
BAND = 3.0


def extremes_names() -> tuple[str, ...]:
    """Direction i points i / 16 of a turn from the picture's right, clockwise."""
    return tuple(f"extremes_{i:02d}_{a}" for i in range(COUNT) for a in "xyz")


def extremes(cloud: Cloud) -> Float32:
    """(48,) float32 metres from the anchor: the mean of the outermost points of 16 directions."""
    result: Float32 = support_points(
        cloud.points, cloud.mask, directions(), np.float32(BAND * cloud.size[1] / 320.0)
    )
    return result.ravel()


def directions() -> Float32:
    """(16, 2) float32 unit vectors (u, v) in the picture."""
    angle = 2.0 * math.pi * np.arange(COUNT) / COUNT
    # Rounded, so that straight up is straight up.
    return np.stack([np.cos(angle), np.sin(angle)], axis=1).round(6).astype(np.float32)


@njit(cache=True, nogil=True)
def support_points(
    points: NDArray[np.float32],
    mask: NDArray[np.bool_],
    ways: NDArray[np.float32],
    band: np.float32,
) -> NDArray[np.float32]:
    """(K, 3) mean of the points whose pixel is within `band` of the outermost one of each way.

    Only the two ends of a row can be outermost, and what is within the band hangs on to them.
    """
    _, h, w = points.shape
    count = ways.shape[0]
    ends = np.empty((h, 2), np.int32)
    for y in range(h):
        a = 0
        while a < w and not mask[y, a]:
            a += 1
        b = w - 1
        while b >= a and not mask[y, b]:
            b -= 1
        ends[y, 0], ends[y, 1] = a, b
    result = np.zeros((count, 3), np.float32)
    for k in range(count):
        du, dv = ways[k, 0], ways[k, 1]
        end = 1 if du >= 0 else 0
        best = np.float32(-1e9)
        for y in range(h):
            if ends[y, 1] >= ends[y, 0]:
                best = max(best, du * np.float32(ends[y, end]) + dv * np.float32(y))
        limit = best - band
        sx = sy = sz = 0.0
        n = 0
        step = -1 if du >= 0 else 1
        for y in range(h):
            x = ends[y, end]
            while ends[y, 0] <= x <= ends[y, 1]:
                if du * np.float32(x) + dv * np.float32(y) < limit:
                    break
                if mask[y, x]:
                    sx += points[0, y, x]
                    sy += points[1, y, x]
                    sz += points[2, y, x]
                    n += 1
                x += step
        if n > 0:
            result[k, 0] = sx / n
            result[k, 1] = sy / n
            result[k, 2] = sz / n
    return result
