"""The compiled engine through a lens: cut triangles into pieces, bend their corners, fill them.

See `bend.py` for the idea and `plain_bend.py` for the same in numpy.
"""

from __future__ import annotations

import numpy as np
from numba import njit
from numpy.typing import NDArray

from clothrf_core.types import Float, Float32
from clothrf_raster.canvas import Keys
from clothrf_raster.compiled_fill import clip, fill

DEEPEST = 128


@njit(cache=True, nogil=True, error_model="numpy")
def draw_bent(
    vertices: Float,
    triangles: NDArray[np.int32],
    pose: Float,
    lens: Float,
    near: float,
    coefficients: Float,
    piece: float,
    window: Float,
    keys: Keys,
    stride: int,
    width: int,
    paint: Keys,
    rows: NDArray[np.int32],
    code: int,
    shades: Float32,
    levels: int,
) -> None:
    """As `compiled._draw`, through a lens."""
    local = np.empty((vertices.shape[0], 3))
    for i in range(vertices.shape[0]):
        x, y, z = vertices[i, 0], vertices[i, 1], vertices[i, 2]
        for k in range(3):
            local[i, k] = pose[k, 0] * x + pose[k, 1] * y + pose[k, 2] * z + pose[k, 3]
    shaded = paint.size > 0
    cut = np.empty((4, 4))
    corners = np.empty((3, 4))
    stack = np.empty((DEEPEST, 3, 4))
    pixel = np.empty((3, 2))
    bent = np.empty((3, 3))
    for m in range(triangles.shape[0]):
        for k in range(3):
            for axis in range(3):
                corners[k, axis] = local[triangles[m, k], axis]
            corners[k, 3] = float(shades[m, k]) if shaded else 0.0
        n = clip(corners, near, cut)
        for k in range(1, n - 1):
            stack[0, 0], stack[0, 1], stack[0, 2] = cut[0], cut[k], cut[k + 1]
            _pieces(
                stack, pixel, bent, lens, coefficients, piece, window,
                keys, stride, width, paint, rows, code, levels,
            )  # fmt: skip


@njit(cache=True, nogil=True, error_model="numpy")
def _pieces(
    stack: Float,
    pixel: Float,
    bent: Float,
    lens: Float,
    k: Float,
    piece: float,
    window: Float,
    keys: Keys,
    stride: int,
    width: int,
    paint: Keys,
    rows: NDArray[np.int32],
    code: int,
    levels: int,
) -> None:
    """Fill the triangle at the bottom of `stack`, bent, in pieces; the arrays are scratch."""
    height = 1
    while height > 0:
        height -= 1
        t = stack[height]
        for i in range(3):
            w = 1.0 / t[i, 2]
            pixel[i, 0] = lens[2] + (lens[0] * t[i, 0] + lens[1] * t[i, 1]) * w
            pixel[i, 1] = lens[4] + lens[3] * t[i, 1] * w
        if not (
            max(pixel[0, 0], pixel[1, 0], pixel[2, 0]) > window[0]
            and max(pixel[0, 1], pixel[1, 1], pixel[2, 1]) > window[1]
            and min(pixel[0, 0], pixel[1, 0], pixel[2, 0]) < window[2]
            and min(pixel[0, 1], pixel[1, 1], pixel[2, 1]) < window[3]
        ):
            continue
        longest, edge = -1.0, 0
        for i in range(3):
            j = (i + 1) % 3
            du, dv = pixel[i, 0] - pixel[j, 0], pixel[i, 1] - pixel[j, 1]
            length = du * du + dv * dv
            if length > longest:
                longest, edge = length, i
        if longest > piece * piece and height + 2 <= stack.shape[0]:
            p, q, r = edge, (edge + 1) % 3, (edge + 2) % 3
            for axis in range(4):
                a, b, c = t[p, axis], t[q, axis], t[r, axis]
                middle = 0.5 * (a + b)
                # The second half lies below the first, which is therefore drawn first.
                stack[height, 0, axis] = middle
                stack[height, 1, axis] = b
                stack[height, 2, axis] = c
                stack[height + 1, 0, axis] = a
                stack[height + 1, 1, axis] = middle
                stack[height + 1, 2, axis] = c
            height += 2
            continue
        for i in range(3):
            w = 1.0 / t[i, 2]
            x, y = t[i, 0] * w, t[i, 1] * w
            r2 = x * x + y * y
            radial = (1.0 + r2 * (k[0] + r2 * (k[1] + r2 * k[4]))) / (
                1.0 + r2 * (k[5] + r2 * (k[6] + r2 * k[7]))
            )
            xd = x * radial + (2.0 * k[2] * x * y + k[3] * (r2 + 2.0 * x * x))
            yd = y * radial + (k[2] * (r2 + 2.0 * y * y) + 2.0 * k[3] * x * y)
            bent[i, 0] = lens[2] + (lens[0] * xd + lens[1] * yd)
            bent[i, 1] = lens[4] + lens[3] * yd
            bent[i, 2] = w
        fill(
            bent[0, 0], bent[0, 1], bent[0, 2], t[0, 3],
            bent[1, 0], bent[1, 1], bent[1, 2], t[1, 3],
            bent[2, 0], bent[2, 1], bent[2, 2], t[2, 3],
            keys, stride, width, paint, rows, code, levels,
        )  # fmt: skip
