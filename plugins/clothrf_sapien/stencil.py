"""Matrices that couple each vertex of a grid with its eight neighbours, compiled.

A matrix is (5, 6, V): of vertex ``a = r C + c`` its own block and those that couple it with a + 1,
a + C, a + C + 1 and a + C - 1, each symmetric and kept as xx, xy, xz, yy, yz, zz. Blocks that would
reach beyond the grid are zero. `second` is one number a vertex, that couples each coordinate of a
with that of a + 2 (bending within a row; zero where a + 2 is in another row).
"""

from __future__ import annotations

from numba import njit

VERTICES = 8
"""Vertices of a group: their unknowns fill three panels of `banded`."""


@njit(cache=True, nogil=True, error_model="numpy")
def hold(matrix, pins, columns):  # type: ignore[no-untyped-def]
    """Identity at the pinned vertices, nothing between them and the others, in place."""
    for a in pins:
        for e in range(6):
            for s in range(5):
                matrix[s, e, a] = 0.0
            for s, o in ((1, 1), (2, columns), (3, columns + 1), (4, columns - 1)):
                if a >= o:
                    matrix[s, e, a - o] = 0.0
        matrix[0, 0, a] = 1.0
        matrix[0, 3, a] = 1.0
        matrix[0, 5, a] = 1.0


@njit(cache=True, nogil=True, error_model="numpy")
def fill(A, S, matrix, second, columns, first, width, group):  # type: ignore[no-untyped-def]
    """Eight vertices of a strip in the layout of `banded`: all of their three panels.

    The strip is the grid's columns from `first` on, `width` of them, as if nothing else existed;
    its vertices are numbered row by row. Padding is the identity.

    Args:
        A: flat float32.
        S: floats a column.
        matrix: (5, 6, V).
        second: (V,).
        columns: C of the grid.
        first: first column of the strip.
        width: its columns.
        group: vertices 8 group to 8 group + 7 of the strip are written.
    """
    rows = matrix.shape[2] // columns
    start = 3 * VERTICES * group * S
    A[start : start + 3 * VERTICES * S] = 0.0
    r, c = divmod(VERTICES * group, width)
    for b in range(VERTICES * group, VERTICES * (group + 1)):
        j = 3 * b
        j0 = j * S + (j & 7)
        j1 = (j + 1) * S + ((j + 1) & 7)
        j2 = (j + 2) * S + ((j + 2) & 7)
        if r >= rows:
            A[j0] = 1.0
            A[j1] = 1.0
            A[j2] = 1.0
            continue
        a = r * columns + first + c
        A[j0] = matrix[0, 0, a]
        A[j0 + 1] = matrix[0, 1, a]
        A[j0 + 2] = matrix[0, 2, a]
        A[j1] = matrix[0, 3, a]
        A[j1 + 1] = matrix[0, 4, a]
        A[j2] = matrix[0, 5, a]
        if c + 1 < width:
            put(A, matrix, 1, a, j0 + 3, j1 + 2, j2 + 1)
            if c + 2 < width:
                A[j0 + 6] = second[a]
                A[j1 + 6] = second[a]
                A[j2 + 6] = second[a]
        if r + 1 < rows:
            o = 3 * width
            put(A, matrix, 2, a, j0 + o, j1 + o - 1, j2 + o - 2)
            if c + 1 < width:
                put(A, matrix, 3, a, j0 + o + 3, j1 + o + 2, j2 + o + 1)
            if c > 0:
                put(A, matrix, 4, a, j0 + o - 3, j1 + o - 4, j2 + o - 5)
        c += 1
        if c == width:
            c = 0
            r += 1


@njit(cache=True, nogil=True, error_model="numpy")
def put(A, matrix, s, a, k0, k1, k2):  # type: ignore[no-untyped-def]
    """Block `s` of vertex `a` to the three places where its columns begin."""
    A[k0] = matrix[s, 0, a]
    A[k0 + 1] = matrix[s, 1, a]
    A[k0 + 2] = matrix[s, 2, a]
    A[k1] = matrix[s, 1, a]
    A[k1 + 1] = matrix[s, 3, a]
    A[k1 + 2] = matrix[s, 4, a]
    A[k2] = matrix[s, 2, a]
    A[k2 + 1] = matrix[s, 4, a]
    A[k2 + 2] = matrix[s, 5, a]


@njit(cache=True, nogil=True, fastmath={"reassoc", "contract"}, error_model="numpy")
def multiply(matrix, second, columns, x, out):  # type: ignore[no-untyped-def]
    """The matrix times (3, V) `x`, into `out`."""
    num = x.shape[1]
    product(matrix[0], x[0], x[1], x[2], out[0], out[1], out[2], num, False)
    for s, o in ((1, 1), (2, columns), (3, columns + 1), (4, columns - 1)):
        n = num - o
        product(matrix[s], x[0, o:], x[1, o:], x[2, o:], out[0], out[1], out[2], n, True)
        product(matrix[s], x[0], x[1], x[2], out[0, o:], out[1, o:], out[2, o:], n, True)
    for i in range(3):
        xi, oi = x[i], out[i]
        x2, o2 = xi[2:], oi[2:]
        for a in range(num - 2):
            oi[a] += second[a] * x2[a]
        for a in range(num - 2):
            o2[a] += second[a] * xi[a]


@njit(cache=True, nogil=True, fastmath={"reassoc", "contract"}, error_model="numpy")
def product(block, x, y, z, u, v, w, n, more):  # type: ignore[no-untyped-def]
    """Blocks, n of them, times (x, y, z) into (u, v, w), or added to it."""
    xx, xy, xz, yy, yz, zz = block[0], block[1], block[2], block[3], block[4], block[5]
    if more:
        for a in range(n):
            u[a] += xx[a] * x[a] + xy[a] * y[a] + xz[a] * z[a]
        for a in range(n):
            v[a] += xy[a] * x[a] + yy[a] * y[a] + yz[a] * z[a]
        for a in range(n):
            w[a] += xz[a] * x[a] + yz[a] * y[a] + zz[a] * z[a]
    else:
        for a in range(n):
            u[a] = xx[a] * x[a] + xy[a] * y[a] + xz[a] * z[a]
        for a in range(n):
            v[a] = xy[a] * x[a] + yy[a] * y[a] + yz[a] * z[a]
        for a in range(n):
            w[a] = xz[a] * x[a] + yz[a] * y[a] + zz[a] * z[a]
