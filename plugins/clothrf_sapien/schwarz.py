"""Solvers for `stencil` matrices: one banded Cholesky, or many narrow ones and a coarse grid.

The price of a band grows with its width: at 100 x 100 vertices a factor cost 13 times more a
vertex than at 21 x 24. So a wide grid is cut into strips that overlap by a column at each side;
their factors and that of the matrix on a grid four times coarser (Galerkin, bilinear) are added up
to one approximate inverse (two-level additive Schwarz; Dryja and Widlund 1990), with which the
conjugate gradients of the whole matrix converge in a few steps, the fewer the closer `TOLERANCE`.
"""

from __future__ import annotations

from itertools import pairwise
from typing import Any, NamedTuple

import numpy as np
from numba import njit

from clothrf_sapien.banded import band_shape, factor, solve
from clothrf_sapien.coarse import collapse, transpose
from clothrf_sapien.stencil import VERTICES, fill, multiply

WIDEST = 32
"""Columns of a grid that is still solved by one band."""
STRIP = 8
"""Columns of a strip, its overlap left out."""
COARSER = 4
TOLERANCE = 0.02
"""Of the error at the start in the norm that conjugate gradients can see."""
MOST = 60
"""Conjugate gradient steps."""


class Plan(NamedTuple):
    """How a grid is solved, and the memory for it.

    Attributes:
        strips: (N, 5) first column, columns, unknowns (padded), floats a column of the band, and
            where it begins in `bands`; the coarse grid last if there is more than one strip.
        bands: flat float32, 64-byte aligned.
        columns: C.
        nodes: rows and columns of the coarse grid.
        row: (R, 2), column: (C, 2) interval of the coarse grid, and share of its far end.
        vectors: (4, 3, V) residual, its image, direction, its product.
        narrow: a strip's unknowns, float32.
        half: (5, 6, Rc C), flipped: (5, 6, C Rc), small: (5, 6, Cc Rc), coarse: (5, 6, Rc Cc).
        still: (Rc Cc,) zeros.
    """

    strips: Any
    bands: Any
    columns: Any
    nodes: Any
    row: Any
    column: Any
    vectors: Any
    narrow: Any
    half: Any
    flipped: Any
    small: Any
    coarse: Any
    still: Any


def plan(rows: int, columns: int) -> Plan:
    """Memory and cuts for a grid of R x C vertices, C <= R."""
    cuts = [0, columns]
    if columns > WIDEST:
        cuts = [round(k * columns / (columns // STRIP)) for k in range(columns // STRIP + 1)]
    strips, total = [], 0
    reach = int(len(cuts) > 2)
    nodes = (len(_nodes(rows)), len(_nodes(columns)))
    parts = [
        (max(begin - reach, 0), min(end + reach, columns), rows) for begin, end in pairwise(cuts)
    ]
    if reach:
        parts.append((0, nodes[1], nodes[0]))
    for begin, end, long in parts:
        width = end - begin
        size, S = band_shape(3 * width * long, 3 * (max(width, 2) + 1) + 2)
        strips.append((begin, width, size, S, total))
        total += -(-size * S // 16) * 16
    num = rows * columns if reach else 0
    few, several = (nodes[0], nodes[1]) if reach else (0, 0)
    raw = np.zeros(total + 16, np.float32)
    skip = -raw.ctypes.data // 4 % 16
    zeros = np.zeros
    return Plan(
        np.array(strips, np.int64),
        raw[skip : skip + total],
        columns,
        np.array(nodes, np.int64),
        _shares(rows),
        _shares(columns),
        zeros((4, 3, num)),
        zeros(max(s[2] for s in strips), np.float32),
        zeros((5, 6, few * columns)),
        zeros((5, 6, few * columns)),
        zeros((5, 6, few * several)),
        zeros((5, 6, few * several)),
        zeros(few * several),
    )


def _nodes(count: int) -> list[int]:
    return sorted({*range(0, count, COARSER), count - 1})


def _shares(count: int) -> np.ndarray[Any, np.dtype[np.float64]]:
    nodes = _nodes(count)
    result = np.zeros((count, 2))
    for k, (a, b) in enumerate(pairwise(nodes)):
        for i in range(a, b + (b == count - 1)):
            result[i] = k, (i - a) / (b - a)
    return result


@njit(cache=True, nogil=True, error_model="numpy")
def build(matrix, second, columns, strip, bands):  # type: ignore[no-untyped-def]
    """Write a strip's part of the matrix group by group, each factored while it is at hand."""
    first, width, size, S, at = strip[0], strip[1], strip[2], strip[3], strip[4]
    A = bands[at : at + size * S]
    for group in range(size // (3 * VERTICES)):
        fill(A, S, matrix, second, columns, first, width, group)
        factor(A, 3 * group, 3 * group + 3, size, S)


@njit(cache=True, nogil=True, error_model="numpy")
def direction(matrix, second, g, pins, plan, p):  # type: ignore[no-untyped-def]
    """The Newton step ``-H^-1 g``.

    Args:
        matrix: (5, 6, V) H.
        second: (V,) see `stencil`.
        g: (3, V), zero at the pinned vertices.
        pins: (P,) vertices that stay.
        plan: of the grid.
        p: (3, V), overwritten.

    Returns:
        Conjugate gradient steps; 0 where one band does it.
    """
    count = len(plan.strips)
    if count == 1:
        build(matrix, second, plan.columns, plan.strips[0], plan.bands)
        p[:] = 0.0
        correct(plan.strips[0], g, plan, -1.0, p)
        return 0
    for k in range(count - 1):
        build(matrix, second, plan.columns, plan.strips[k], plan.bands)
    collapse(matrix, second, plan.columns, plan.row, plan.half)
    rows = plan.nodes[0]
    transpose(plan.half, plan.columns, plan.flipped)
    collapse(plan.flipped, plan.still[:0], rows, plan.column, plan.small)
    transpose(plan.small, rows, plan.coarse)
    build(plan.coarse, plan.still, plan.nodes[1], plan.strips[count - 1], plan.bands)
    return iterate(matrix, second, g, pins, plan, p)


@njit(cache=True, nogil=True, error_model="numpy")
def iterate(matrix, second, g, pins, plan, p):  # type: ignore[no-untyped-def]
    """Preconditioned conjugate gradients (Hestenes and Stiefel 1952) for ``H p = -g``."""
    r, z, d, q = plan.vectors[0], plan.vectors[1], plan.vectors[2], plan.vectors[3]
    num = g.shape[1]
    p[:] = 0.0
    for i in range(3):
        for a in range(num):
            r[i, a] = -g[i, a]
    precondition(r, pins, plan, z)
    d[:] = z
    now = inner(r, z)
    goal = TOLERANCE * TOLERANCE * now
    for step in range(1, MOST + 1):
        if now <= 0.0:
            return step
        multiply(matrix, second, plan.columns, d, q)
        alpha = now / inner(d, q)
        for i in range(3):
            for a in range(num):
                p[i, a] += alpha * d[i, a]
            for a in range(num):
                r[i, a] -= alpha * q[i, a]
        precondition(r, pins, plan, z)
        before = now
        now = inner(r, z)
        if now <= goal:
            return step
        beta = now / before
        for i in range(3):
            for a in range(num):
                d[i, a] = z[i, a] + beta * d[i, a]
    return MOST


@njit(cache=True, nogil=True, fastmath={"reassoc", "contract"}, error_model="numpy")
def inner(x, y):  # type: ignore[no-untyped-def]
    """Inner product of two (3, V) vectors."""
    total = 0.0
    for i in range(3):
        xi, yi = x[i], y[i]
        for a in range(len(xi)):
            total += xi[a] * yi[a]
    return total


@njit(cache=True, nogil=True, error_model="numpy")
def precondition(r, pins, plan, z):  # type: ignore[no-untyped-def]
    """The approximate inverse times `r`, into `z`."""
    count = len(plan.strips)
    z[:] = 0.0
    for k in range(count - 1):
        correct(plan.strips[k], r, plan, 1.0, z)
    correct_coarsely(plan.strips[count - 1], r, plan, z)
    for i in range(3):
        for a in pins:
            z[i, a] = 0.0


@njit(cache=True, nogil=True, error_model="numpy")
def correct(strip, r, plan, sign, z):  # type: ignore[no-untyped-def]
    """Add ``sign`` times a strip's solution for the right-hand side `r` to `z`."""
    first, width, size, S, at = strip[0], strip[1], strip[2], strip[3], strip[4]
    columns, x = plan.columns, plan.narrow[:size]
    rows = r.shape[1] // columns
    x[3 * rows * width :] = 0.0
    for i in range(3):
        for row in range(rows):
            part = r[i, row * columns + first : row * columns + first + width]
            for c in range(width):
                x[3 * (row * width + c) + i] = sign * part[c]
    solve(plan.bands[at : at + size * S], size, S, x)
    for i in range(3):
        for row in range(rows):
            part = z[i, row * columns + first : row * columns + first + width]
            for c in range(width):
                part[c] += x[3 * (row * width + c) + i]


@njit(cache=True, nogil=True, error_model="numpy")
def correct_coarsely(strip, r, plan, z):  # type: ignore[no-untyped-def]
    """Add the coarse grid's solution for `r`, which is restricted to it, to `z`."""
    several, size, S, at = strip[1], strip[2], strip[3], strip[4]
    few, columns, x = plan.nodes[0], plan.columns, plan.narrow[:size]
    rows = r.shape[1] // columns
    between = np.empty((few, columns))
    x[:] = 0.0
    for i in range(3):
        between[:] = 0.0
        for row in range(rows):
            t = plan.row[row, 1]
            part = r[i, row * columns : (row + 1) * columns]
            near, far = between[int(plan.row[row, 0])], between[int(plan.row[row, 0]) + 1]
            for c in range(columns):
                near[c] += (1.0 - t) * part[c]
            for c in range(columns):
                far[c] += t * part[c]
        for k in range(few):
            for c in range(columns):
                b, s = 3 * (k * several + int(plan.column[c, 0])) + i, plan.column[c, 1]
                x[b] += (1.0 - s) * between[k, c]
                x[b + 3] += s * between[k, c]
    solve(plan.bands[at : at + size * S], size, S, x)
    for i in range(3):
        for k in range(few):
            for c in range(columns):
                b, s = 3 * (k * several + int(plan.column[c, 0])) + i, plan.column[c, 1]
                between[k, c] = (1.0 - s) * x[b] + s * x[b + 3]
        for row in range(rows):
            t = plan.row[row, 1]
            part = z[i, row * columns : (row + 1) * columns]
            near, far = between[int(plan.row[row, 0])], between[int(plan.row[row, 0]) + 1]
            for c in range(columns):
                part[c] += (1.0 - t) * near[c] + t * far[c]
