"""The same z-buffer in plain numpy: the fallback without numba, and what `compiled.py` must equal.

Every number is computed by the same operations in the same order, so the two engines give the
same bits. All triangles of a mesh are cut into rows at once, the rows into pixels at once; of the
fragments that fall on one pixel the closest wins, and of equally close ones the first.
"""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from clothrf_core.scene import SceneMesh
from clothrf_core.types import Float, Float32
from clothrf_raster.canvas import HALF, ROUND, Canvas, Ink
from clothrf_raster.plain_bend import bent_corners
from clothrf_raster.shading import LEVELS, corner_shades
from clothrf_raster.view import View

__all__ = ["corner_shades", "draw", "finish", "look_up"]

ONE = np.float32(1.0)
ZERO = np.float32(0.0)
LIMIT = 1e12


def draw(canvas: Canvas, view: View, mesh: SceneMesh, ink: Ink) -> None:
    """Draw `mesh` on `canvas` wherever it is closer than what is there."""
    with np.errstate(all="ignore"):
        corners = _corners(view, mesh, ink, colour=canvas.rgb.size > 0)
        _fill(canvas, corners, ink)


def finish(canvas: Canvas, view: View, depth: Float32, labels: NDArray[np.uint8]) -> None:
    """Write metres, or NaN where nothing measurable is seen, and labels; both (H, W)."""
    keys = canvas.keys[:, : canvas.width]
    with np.errstate(all="ignore"):
        z = ONE / (keys & ROUND).view(np.float32)
    z = np.minimum(np.maximum(z, np.float32(view.near)), np.float32(view.far))
    seen = keys > canvas.empty
    depth[:] = np.where(seen & ((keys & 1) == 1), z, np.float32(np.nan))
    labels[:] = np.where(seen, 15 - ((keys >> 1) & 15), 0)


def look_up(
    shades: NDArray[np.uint8],
    across: NDArray[np.uint8],
    down: NDArray[np.uint8],
    texels: NDArray[np.uint8],
    palettes: NDArray[np.uint8],
    rgb: NDArray[np.uint8],
) -> None:
    """Colour `rgb` (H, W, 3) where the three counts of it say so, see `printing`.

    Args:
        shades: (H, W, 3) uint8 entry of the palettes in two bytes, then whether anything is there.
        across: the same for the place on the pattern from its left, in `LEVELS` steps.
        down: the same from its upper edge.
        texels: (h, w) uint8 colour numbers.
        palettes: (K, LEVELS, 3) uint8.
        rgb: written.
    """
    rows, columns = np.nonzero(shades[:, :, 2])
    found = [c[rows, columns].astype(np.int64) for c in (shades, across, down)]
    shade, u, v = (f[:, 0] + 256 * f[:, 1] for f in found)
    h, w = texels.shape
    rgb[rows, columns] = palettes[texels[v * h // LEVELS, u * w // LEVELS], shade]


def _corners(view: View, mesh: SceneMesh, ink: Ink, *, colour: bool) -> Float:
    """(3, 4, N) float64 u, v, inverse depth and shade of what lies beyond the near plane."""
    p = view.pose
    x, y, z = mesh.vertices.T
    local = np.stack([p[k, 0] * x + p[k, 1] * y + p[k, 2] * z + p[k, 3] for k in range(3)], axis=1)
    shades = ink.shades.astype(float) if colour else np.zeros(mesh.triangles.shape)
    triangles = np.concatenate([local[mesh.triangles], shades[:, :, None]], axis=2)
    beyond = triangles[:, :, 2] >= view.near
    whole = beyond.all(axis=1)
    cut = np.flatnonzero(beyond.any(axis=1) & ~whole)
    halves = [_clip(triangles[m], view.near) for m in cut]
    owners = np.concatenate([np.flatnonzero(whole), np.repeat(cut, [len(h) for h in halves])])
    triangles = np.concatenate([triangles[whole], *halves])[np.argsort(owners, kind="stable")]
    if view.bend.piece > 0.0:
        return bent_corners(triangles, view.lens, view.bend).transpose(1, 2, 0)
    fx, skew, cx, fy, cy = view.lens
    x, y, w = triangles[..., 0], triangles[..., 1], 1.0 / triangles[..., 2]
    pixels = [cx + (fx * x + skew * y) * w, cy + fy * y * w, w, triangles[..., 3]]
    return np.stack(pixels, axis=-1).transpose(1, 2, 0)


def _clip(corners: Float, near: float) -> Float:
    """(1 or 2, 3, 4) triangles: the part of a (3, 4) triangle beyond the near plane."""
    cut = []
    for i, j in ((0, 1), (1, 2), (2, 0)):
        if corners[i, 2] >= near:
            cut.append(corners[i])
        if (corners[i, 2] >= near) != (corners[j, 2] >= near):
            if corners[i, 2] < near:
                i, j = j, i  # from the visible end, so that neighbours agree
            t = (corners[i, 2] - near) / (corners[i, 2] - corners[j, 2])
            point = corners[i] + t * (corners[j] - corners[i])
            point[2] = near
            cut.append(point)
    return np.stack([np.stack([cut[0], cut[k], cut[k + 1]]) for k in range(1, len(cut) - 1)])


def _fill(canvas: Canvas, corners: Float, ink: Ink) -> None:
    height, stride = canvas.keys.shape
    width = canvas.width
    a, b, c = corners
    a, b = _sorted(a, b)
    a, c = _sorted(a, c)
    b, c = _sorted(b, c)
    area = (b[0] - a[0]) * (c[1] - a[1]) - (c[0] - a[0]) * (b[1] - a[1])
    us = np.stack([a[0], b[0], c[0]])
    keep = (c[1] > -1.0) & (a[1] < height) & (us.max(0) > -1.0) & (us.min(0) < width)
    far_out = np.abs(np.stack([*us, a[1], c[1]])).max(axis=0)
    keep &= (np.abs(area) > 0.0) & (far_out < LIMIT)
    a, b, c, area = a[:, keep], b[:, keep], c[:, keep], area[keep]
    top = np.ceil(np.maximum(a[1], 0.0)).astype(np.int64)
    bottom = np.ceil(np.minimum(c[1], float(height))).astype(np.int64)

    m, row = _runs(top, np.maximum(bottom - top, 0))
    y = row.astype(float)
    x0 = a[0][m] + (y - a[1][m]) * ((c[0] - a[0]) / (c[1] - a[1]))[m]
    upper = a[0][m] + (y - a[1][m]) * ((b[0] - a[0]) / (b[1] - a[1]))[m]
    lower = b[0][m] + (y - b[1][m]) * ((c[0] - b[0]) / (c[1] - b[1]))[m]
    x1 = np.where(y < b[1][m], upper, lower)
    left = np.ceil(np.maximum(np.minimum(x0, x1), 0.0))
    right = np.ceil(np.minimum(np.maximum(x0, x1), float(width)))
    n = np.maximum(right - left, 0.0).astype(np.int64)
    r, i = _runs(np.zeros(len(n), np.int64), n)
    t = m[r]
    along = i.astype(np.float32)

    start, step = _plane(a, b, c, a[2], b[2], c[2], area, m, left, y)
    low = np.minimum(np.minimum(a[2], b[2]), c[2]).astype(np.float32)
    high = np.maximum(np.maximum(a[2], b[2]), c[2]).astype(np.float32)
    w = np.minimum(np.maximum(start[r] + along * step[t], low[t]), high[t])
    key = ((w.view(np.int32) + HALF) & ROUND) | np.int32(ink.code)
    where = row[r] * stride + left[r].astype(np.int64) + i
    keys = canvas.keys.reshape(-1)
    closer = np.flatnonzero(key > keys[where])
    np.maximum.at(keys, where[closer], key[closer])
    if canvas.rgb.size > 0:
        # Backwards, because of several writes to one element numpy keeps the last.
        won = closer[key[closer] == keys[where[closer]]][::-1]
        q = (a[3] * a[2], b[3] * b[2], c[3] * c[2])
        shade, step = _plane(a, b, c, *q, area, m, left, y)
        r, i, t = r[won], i[won], t[won]
        s = np.minimum(np.maximum((shade[r] + along[won] * step[t]) * (ONE / w[won]), ZERO), ONE)
        level = (s * np.float32(len(ink.palette) - 1)).astype(np.int64)
        canvas.rgb[row[r], left[r].astype(np.int64) + i] = ink.palette[level]


def _plane(
    a: Float,
    b: Float,
    c: Float,
    qa: Float,
    qb: Float,
    qc: Float,
    area: Float,
    m: NDArray[np.int64],
    x: Float,
    y: Float,
) -> tuple[Float32, Float32]:
    """Values at (x, y) of triangle `m` (per row) and steps along x (per triangle) of a plane."""
    gx = ((qb - qa) * (c[1] - a[1]) - (qc - qa) * (b[1] - a[1])) / area
    gy = ((b[0] - a[0]) * (qc - qa) - (c[0] - a[0]) * (qb - qa)) / area
    value = qa[m] + (x - a[0][m]) * gx[m] + (y - a[1][m]) * gy[m]
    return value.astype(np.float32), gx.astype(np.float32)


def _sorted(a: Float, b: Float) -> tuple[Float, Float]:
    """The two corners of each triangle, the upper one first."""
    swap = b[1] < a[1]
    return np.where(swap, b, a), np.where(swap, a, b)


def _runs(
    start: NDArray[np.int64], length: NDArray[np.int64]
) -> tuple[NDArray[np.int64], NDArray[np.int64]]:
    """Owner and value of every number in the runs start, start + 1, ... of the given lengths."""
    owner = np.repeat(np.arange(len(length)), length)
    before = np.cumsum(length) - length
    return owner, start[owner] + np.arange(len(owner)) - before[owner]
