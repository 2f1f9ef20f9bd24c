"""What alignment removes from the picture: where the foreground was, how large, how far."""

from __future__ import annotations

import numpy as np

from clothrf_core.types import Float, Float32
from clothrf_how.foreground import Foreground


def pose_names() -> tuple[str, ...]:
    """Seven names."""
    return ("pose_u", "pose_v", "pose_scale", "pose_depth", "pose_x", "pose_y", "pose_z")


def pose(area: Foreground, anchor: Float) -> Float32:
    """(7,) float32.

    Middle column and row over the picture's width, root of the share of the picture covered, mean
    depth in metres, and the anchor in the world, metres.
    """
    h, w = area.mask.shape
    u, v, depth = area.centre
    return np.array([u / w, v / w, np.sqrt(area.area / (h * w)), depth, *anchor], np.float32)
