"""Which of two things is the cloth, where hands and arms fill as much of the picture as it does."""

from __future__ import annotations

import cv2
import numpy as np
from numpy.typing import NDArray

from clothrf_core.types import Float, Float32

# Metres from the line between the grippers within which cloth is held, and pixels of it that tell.
HELD = 0.12
BETWEEN = 100

Piece = tuple[NDArray[np.bool_], Float32]
"""(h, w) bool mask, and (h, w) float32 depth in metres."""


def fits_better(
    one: Piece, other: Piece, directions: Float32, origin: Float32, grasp: Float | None
) -> bool:
    """Whether more of the first piece than of the other lies between the grippers.

    Where they are not known, or nothing lies there: whether it is thicker.

    Args:
        one: a piece.
        other: another.
        directions: (3, h, w) float32 world direction of each pixel's ray, of unit depth.
        origin: (3,) float32 camera centre, world.
        grasp: (2, 3) world metres, where the robot holds the cloth; None or NaN = not known.
    """
    if grasp is not None and np.isfinite(grasp).all():
        counts = [between(piece, directions, origin, grasp) for piece in (one, other)]
        if max(counts) >= BETWEEN:
            return counts[0] > counts[1]
    return thickness(one[0]) > thickness(other[0])


def between(piece: Piece, directions: Float32, origin: Float32, grasp: Float) -> int:
    """Pixels whose points are `HELD` metres from the line between the grippers at most."""
    mask, depth = piece
    points = (origin[:, None] + depth[mask] * directions[:, mask]).T
    line = grasp[1] - grasp[0]
    along = (points - grasp[0]) @ line / max(float(line @ line), 1e-9)
    off = points - (grasp[0] + np.clip(along, 0.0, 1.0)[:, None] * line)
    return int(np.count_nonzero((off**2).sum(axis=1) < HELD * HELD))


def thickness(mask: NDArray[np.bool_]) -> float:
    """Sum over a mask of the distance to its rim, pixels: large for sheets, small for arms."""
    inside = cv2.distanceTransform(
        src=mask.view(np.uint8), distanceType=cv2.DIST_L2, maskSize=cv2.DIST_MASK_3
    )
    return float(inside.sum(dtype=np.float64))
