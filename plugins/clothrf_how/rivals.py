"""Which of two things is the cloth, where hands and arms fill as much of the picture as it does."""

from __future__ import annotations

import cv2
import numpy as np
from numpy.typing import NDArray

from clothrf_core.types import Float, Float32

# Metres added to the distance from the grippers: nothing is infinitely near.
NEARBY = 0.02

Piece = tuple[NDArray[np.bool_], Float32]
"""(h, w) bool mask, and (h, w) float32 depth in metres."""


def fits_better(
    one: Piece, other: Piece, directions: Float32, origin: Float32, grasp: Float | None
) -> bool:
    """Whether the first piece is more of a sheet, and nearer to the grippers, than the other.

    The score is thickness over distance: arms are thin, and they hold the far end; grippers are
    near, but thinner still.

    Args:
        one: a piece.
        other: another.
        directions: (3, h, w) float32 world direction of each pixel's ray, of unit depth.
        origin: (3,) float32 camera centre, world.
        grasp: (2, 3) world metres, where the robot holds the cloth; None or NaN = not known.
    """
    scores = [thickness(mask) for mask, _ in (one, other)]
    if grasp is not None and np.isfinite(grasp).all() and min(scores) > 0.0:
        for k, piece in enumerate((one, other)):
            scores[k] /= NEARBY + distance(piece, directions, origin, grasp)
    return scores[0] > scores[1]


def distance(piece: Piece, directions: Float32, origin: Float32, grasp: Float) -> float:
    """Median distance of a piece's points from the line between the grippers, metres."""
    mask, depth = piece
    points = (origin[:, None] + depth[mask] * directions[:, mask]).T
    line = grasp[1] - grasp[0]
    along = (points - grasp[0]) @ line / max(float(line @ line), 1e-9)
    off = points - (grasp[0] + np.clip(along, 0.0, 1.0)[:, None] * line)
    return float(np.median(np.linalg.norm(off, axis=1)))


def thickness(mask: NDArray[np.bool_]) -> float:
    """Sum over a mask of the distance to its rim, pixels: large for sheets, small for arms."""
    inside = cv2.distanceTransform(
        src=mask.view(np.uint8), distanceType=cv2.DIST_L2, maskSize=cv2.DIST_MASK_3
    )
    return float(inside.sum(dtype=np.float64))
