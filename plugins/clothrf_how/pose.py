"""What alignment removes from the picture: where the foreground was, how large, how far."""

from __future__ import annotations

import numpy as np

from clothrf_core.types import Float32
from clothrf_how.foreground import Foreground


def pose_names() -> tuple[str, ...]:
    """Four names."""
    return ("pose_u", "pose_v", "pose_scale", "pose_depth")


def pose(area: Foreground) -> Float32:
    """(4,) float32: middle column and row over the picture's width, root area share, depth (m)."""
    h, w = area.mask.shape
    u, v, _ = area.centre
    x0, y0, x1, y1 = area.box
    depth = area.depth[y0:y1, x0:x1]
    median = np.median(depth[area.mask[y0:y1, x0:x1]])
    return np.array([u / w, v / w, np.sqrt(area.area / (h * w)), median], np.float32)
