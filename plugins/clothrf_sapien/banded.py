"""Banded Cholesky for the Newton steps of the cloth, compiled.

The symmetric positive definite matrix H of half-width w is kept column by column: ``A[j, t]`` is
``H[j + t, j]``, zero for t > w, so a column is contiguous. Golub and Van Loan, Matrix Computations
(2013), section 4.3.5, in blocks of four columns: 12 multipliers stay in registers while three
columns at a time are updated.
"""

from __future__ import annotations

import numpy as np
from numba import njit

BLOCK = 4
"""Rows of the matrix are padded to a multiple of this; the padding is the identity."""


def band_shape(size: int, half_width: int) -> tuple[int, int]:
    """Rows and columns of the array that holds a matrix of `size` rows, padding included."""
    rows = -(-size // BLOCK) * BLOCK
    columns = -(-(half_width + 1 + 2 * BLOCK) // 8) * 8
    return rows + BLOCK, columns


# contract: multiply-add in one rounding; the result is the same from run to run.
@njit(cache=True, nogil=True, fastmath={"contract"}, error_model="numpy")
def factor(A, n, w):  # type: ignore[no-untyped-def]
    """Replace H by its Cholesky factor L in place; ``A[j, 0]`` becomes ``1 / L[j, j]``.

    A pivot that is not positive (round-off) is replaced by a large one: that unknown stays still.

    Args:
        A: `band_shape` array, float32 or float64, columns of H as above.
        n: number of rows of H, a multiple of `BLOCK`.
        w: half-width.

    Returns:
        Number of pivots that were replaced.
    """
    one = A.dtype.type(1.0)
    bad = 0
    for j0 in range(0, n, 4):
        for k in range(j0, j0 + 4):
            column = A[k]
            pivot = column[0]
            if not pivot > 0.0:
                bad += 1
                pivot = A.dtype.type(1e12)
            scale = one / np.sqrt(pivot)
            for t in range(1, w + 1):
                column[t] *= scale
            column[0] = scale
            for j in range(k + 1, j0 + 4):
                other = A[j]
                o = j - k
                m = column[o]
                for t in range(w + 1 - o):
                    other[t] -= m * column[o + t]
        end = min(j0 + 3 + w, n - 1)
        p0, p1, p2, p3 = A[j0], A[j0 + 1], A[j0 + 2], A[j0 + 3]
        for j in range(j0 + 4, end + 1, 3):
            o = j - j0
            a0, a1, a2, a3 = p0[o], p1[o - 1], p2[o - 2], p3[o - 3]
            b0, b1, b2, b3 = p0[o + 1], p1[o], p2[o - 1], p3[o - 2]
            e0, e1, e2, e3 = p0[o + 2], p1[o + 1], p2[o], p3[o - 1]
            c0, c1, c2 = A[j], A[j + 1], A[j + 2]
            c0[0] -= a0 * a0 + a1 * a1 + a2 * a2 + a3 * a3
            c0[1] -= a0 * b0 + a1 * b1 + a2 * b2 + a3 * b3
            c1[0] -= b0 * b0 + b1 * b1 + b2 * b2 + b3 * b3
            m = end - j - 1
            q0, q1 = p0[o + 2 : o + 2 + m], p1[o + 1 : o + 1 + m]
            q2, q3 = p2[o : o + m], p3[o - 1 : o - 1 + m]
            d0, d1, d2 = c0[2 : 2 + m], c1[1 : 1 + m], c2[0:m]
            for t in range(m):
                x0, x1, x2, x3 = q0[t], q1[t], q2[t], q3[t]
                d0[t] -= a0 * x0 + a1 * x1 + a2 * x2 + a3 * x3
                d1[t] -= b0 * x0 + b1 * x1 + b2 * x2 + b3 * x3
                d2[t] -= e0 * x0 + e1 * x1 + e2 * x2 + e3 * x3
    return bad


# reassoc: the dot products of the backward sweep are summed in lanes.
@njit(cache=True, nogil=True, fastmath={"contract", "reassoc"}, error_model="numpy")
def solve(A, n, w, x):  # type: ignore[no-untyped-def]
    """Solve ``L L^T x = b`` in place with the factor of `factor`.

    Args:
        A: as `factor` left it.
        n: number of rows, a multiple of `BLOCK`.
        w: half-width.
        x: right-hand side, replaced by the solution; at least n + w long, zero beyond n.
    """
    for j in range(n):
        column = A[j]
        value = x[j] * column[0]
        x[j] = value
        tail = x[j + 1 : j + 1 + w]
        for t in range(w):
            tail[t] -= value * column[t + 1]
    for t in range(n, n + w):
        x[t] = 0.0
    for j in range(n - 1, -1, -1):
        column = A[j]
        tail = x[j + 1 : j + 1 + w]
        total = A.dtype.type(0.0)
        for t in range(w):
            total += tail[t] * column[t + 1]
        x[j] = (x[j] - total) * column[0]
