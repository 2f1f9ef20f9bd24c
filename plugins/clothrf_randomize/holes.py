"""Blobs of missing depth: dark or shiny spots on which a sensor reads nothing."""

from __future__ import annotations

from typing import Any

import numpy as np
from numba import njit

from clothrf_core.types import Float, Float32
from clothrf_randomize.edges import Window

SMALLEST, LARGEST = 5.0, 40.0
MOST = 3


def draw_blobs(rng: np.random.Generator, window: Window, strength: float) -> Float:
    """(B, 5) float64 rows (y, x, a, b, angle): ellipses with semi-axes a and b, pixels.

    0 to 3 `strength` of them, 5 to 40 pixels across, anywhere in the window.
    """
    count = int(rng.integers(0, round(MOST * strength) + 1))
    return np.column_stack(
        [
            rng.uniform(window.top, window.bottom, count),
            rng.uniform(window.left, window.right, count),
            0.5 * rng.uniform(SMALLEST, LARGEST, count),
            0.5 * rng.uniform(SMALLEST, LARGEST, count),
            rng.uniform(0.0, np.pi, count),
        ]
    )


def punch(depth: Float32, blobs: Float) -> None:
    """Make the pixels of `depth` inside `blobs` NaN, in place."""
    if len(blobs):
        _punch(depth, blobs)


@njit(cache=True, nogil=True)
def _punch(depth: Any, blobs: Any) -> None:
    height, width = depth.shape
    for k in range(blobs.shape[0]):
        y0, x0, a, b, angle = blobs[k]
        cos, sin = np.cos(angle), np.sin(angle)
        reach = max(a, b)
        for y in range(max(0, int(y0 - reach)), min(height, int(y0 + reach) + 2)):
            for x in range(max(0, int(x0 - reach)), min(width, int(x0 + reach) + 2)):
                dy, dx = y - y0, x - x0
                along = (cos * dx + sin * dy) / a
                across = (cos * dy - sin * dx) / b
                if along * along + across * across <= 1.0:
                    depth[y, x] = np.nan
