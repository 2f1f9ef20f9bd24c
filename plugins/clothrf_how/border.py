"""Where the picture cuts the cloth off, and how much."""

from __future__ import annotations

import numpy as np

from clothrf_core.types import Float32
from clothrf_how.cloud import Cloud

SIDES = ("left", "right", "top", "bottom")


def border_names() -> tuple[str, ...]:
    """Seven a side: share of the side that is touched; first and last touching point."""
    return tuple(
        f"border_{side}_{part}"
        for side in SIDES
        for part in ("share", *(f"{end}_{a}" for end in ("first", "last") for a in "xyz"))
    )


def border(cloud: Cloud) -> Float32:
    """(28,) float32; a side that is not touched has zeros. Points in metres from the anchor."""
    x0, y0, x1, y1 = cloud.box
    h, w = cloud.size
    # Mask and points along each side of the box, where that side is the picture's.
    sides = (
        (x0 == 0, cloud.mask[:, 0], cloud.points[:, :, 0]),
        (x1 == w, cloud.mask[:, -1], cloud.points[:, :, -1]),
        (y0 == 0, cloud.mask[0], cloud.points[:, 0]),
        (y1 == h, cloud.mask[-1], cloud.points[:, -1]),
    )
    values = np.zeros((4, 7), np.float32)
    for side, (touches, mask, points) in enumerate(sides):
        if touches:
            where = np.flatnonzero(mask)
            values[side, 0] = where.size / (h if side < 2 else w)
            values[side, 1:4] = points[:, where[0]]
            values[side, 4:7] = points[:, where[-1]]
    return values.ravel()
