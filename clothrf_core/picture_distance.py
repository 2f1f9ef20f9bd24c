"""How far apart two pictures of a cloth are: the paper's dist(O(c), O(c*)) (section III).

The paper leaves the distance open. This one compares depth where either picture shows cloth:
metres, saturated, so that a small shift counts a little and a missing cloth counts fully.
"""

from __future__ import annotations

import numpy as np

from clothrf_core.scene import Label, Picture

SATURATION_M = 0.05


def picture_distance(seen: Picture, wanted: Picture, *, saturation: float = SATURATION_M) -> float:
    """Mean saturated depth difference over the pixels that show cloth in either picture.

    Args:
        seen: O(c), the picture now.
        wanted: O(c*), the picture as it should be; same camera.
        saturation: m; differences from here on, and cloth in only one picture, count 1.

    Returns:
        0 for equal pictures, 1 if no cloth overlaps (or neither shows any).
    """
    here, there = seen.labels == Label.CLOTH, wanted.labels == Label.CLOTH
    either = here | there
    if not either.any():
        return 1.0
    both = here & there
    difference = np.ones(int(either.sum()))
    depth = np.abs(seen.frame.depth - wanted.frame.depth)[either]
    overlap = both[either] & np.isfinite(depth)
    difference[overlap] = np.minimum(depth[overlap] / saturation, 1.0)
    return float(difference.mean())
