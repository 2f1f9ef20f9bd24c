"""The cloth as points in the world, metres from the anchor: what the shape channels measure.

Axes are the world's (x forward, z up), so the direction of gravity is always the same, whatever
the camera's pose.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numba import njit
from numpy.typing import NDArray

from clothrf_core.types import Float, Float32
from clothrf_how.foreground import Foreground


@dataclass(frozen=True, slots=True, eq=False)
class Cloud:
    """The foreground's box as points.

    Attributes:
        points: (3, bh, bw) float32, metres from the anchor, world axes; 0 outside the mask.
        mask: (bh, bw) bool.
        box: (x0, y0, x1, y1) of the box in the picture, working pixels.
        size: (h, w) of the picture, working pixels.
    """

    points: Float32
    mask: NDArray[np.bool_]
    box: tuple[int, int, int, int]
    size: tuple[int, int]

    @classmethod
    def of(cls, area: Foreground, anchor: Float) -> Cloud:
        """The points of a usable foreground."""
        x0, y0, x1, y1 = area.box
        view = area.view
        start = (view.camera.T_world_camera[:3, 3] - anchor).astype(np.float32)
        # Whole rows side by side: only then are the loops over them vector code.
        mask = np.ascontiguousarray(area.mask[y0:y1, x0:x1])
        points = placed(area.depth, area.mask, view.directions, start, area.box)
        return cls(points=points, mask=mask, box=area.box, size=area.mask.shape)


@njit(cache=True, nogil=True)
def placed(
    depth: NDArray[np.float32],
    mask: NDArray[np.bool_],
    directions: NDArray[np.float32],
    start: NDArray[np.float32],
    box: tuple[int, int, int, int],
) -> NDArray[np.float32]:
    """(3, bh, bw) float32 ``start + depth * direction`` of the half-open box; 0 outside the mask.

    Rows of slices of the arguments are not known to be dense, and their loop is not vector code.
    """
    x0, y0, x1, y1 = box
    h, w = y1 - y0, x1 - x0
    points = np.empty((3, h, w), np.float32)
    zero = np.float32(0.0)
    for axis in range(3):
        offset = start[axis]
        for y in range(h):
            row, inside = depth[y0 + y, x0:x1], mask[y0 + y, x0:x1]
            ray, line = directions[axis, y0 + y, x0:x1], points[axis, y]
            for x in range(w):
                value = offset + row[x] * ray[x]
                line[x] = value if inside[x] else zero
    return points
