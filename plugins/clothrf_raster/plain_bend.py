"""The numpy engine through a lens; the same arithmetic as `compiled_bend.py`."""

from __future__ import annotations

import numpy as np

from clothrf_core.types import Float
from clothrf_raster.bend import Bend


def bent_corners(triangles: Float, lens: Float, bend: Bend) -> Float:
    """(P, 3, 4) u, v, inverse depth and shade of all pieces, in the order of the triangles.

    Args:
        triangles: (N, 3, 4) x, y, z in the camera's frame and shade, beyond the near plane.
        lens: (5,) fx, skew, cx, fy, cy.
        bend: of the camera.
    """
    left, top, right, bottom = bend.window
    rows = np.arange(3)
    for _ in range(256):
        u, v = _pinhole(triangles, lens)
        seen = (u.max(1) > left) & (v.max(1) > top) & (u.min(1) < right) & (v.min(1) < bottom)
        triangles, u, v = triangles[seen], u[seen], v[seen]
        du, dv = u - u[:, (rows + 1) % 3], v - v[:, (rows + 1) % 3]
        length = du * du + dv * dv
        edge = length.argmax(axis=1)
        long = length.max(axis=1, initial=-1.0) > bend.piece * bend.piece
        if not long.any():
            break
        every = np.arange(len(triangles))
        a = triangles[every, edge]
        b = triangles[every, (edge + 1) % 3]
        c = triangles[every, (edge + 2) % 3]
        middle = 0.5 * (a + b)
        copies = np.where(long, 2, 1)
        first = np.cumsum(copies) - copies
        cut = np.repeat(triangles, copies, axis=0)
        cut[first[long]] = np.stack([a, middle, c], axis=1)[long]
        cut[first[long] + 1] = np.stack([middle, b, c], axis=1)[long]
        triangles = cut
    return _bent(triangles, lens, bend.coefficients)


def _pinhole(triangles: Float, lens: Float) -> tuple[Float, Float]:
    x, y, w = triangles[..., 0], triangles[..., 1], 1.0 / triangles[..., 2]
    return lens[2] + (lens[0] * x + lens[1] * y) * w, lens[4] + lens[3] * y * w


def _bent(triangles: Float, lens: Float, k: Float) -> Float:
    w = 1.0 / triangles[..., 2]
    x, y = triangles[..., 0] * w, triangles[..., 1] * w
    r2 = x * x + y * y
    radial = (1.0 + r2 * (k[0] + r2 * (k[1] + r2 * k[4]))) / (
        1.0 + r2 * (k[5] + r2 * (k[6] + r2 * k[7]))
    )
    xd = x * radial + (2.0 * k[2] * x * y + k[3] * (r2 + 2.0 * x * x))
    yd = y * radial + (k[2] * (r2 + 2.0 * y * y) + 2.0 * k[3] * x * y)
    u = lens[2] + (lens[0] * xd + lens[1] * yd)
    v = lens[4] + lens[3] * yd
    return np.stack([u, v, w, triangles[..., 3]], axis=-1)
