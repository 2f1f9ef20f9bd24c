"""A `stencil` matrix on a coarser grid, compiled: P^T H P for linear interpolation P along rows.

Once along the rows and, transposed, once along the columns gives the bilinear one.
"""

from __future__ import annotations

from numba import njit


@njit(cache=True, nogil=True, error_model="numpy")
def collapse(matrix, second, columns, shares, out):  # type: ignore[no-untyped-def]
    """P^T H P, where P interpolates between some of the rows.

    What `second` adds is bounded by a diagonal: ``2 s x y <= s (x^2 + y^2)``.

    Args:
        matrix: (5, 6, R C).
        second: (R C,) or shorter, then taken for zero.
        columns: C.
        shares: (R, 2) the interval K of each row, and the share of its far end.
        out: (5, 6, Rc C), overwritten.
    """
    rows = matrix.shape[2] // columns
    out[:] = 0.0
    n = columns
    for r in range(rows):
        here = r * n
        u = shares[r, 1]
        K = int(shares[r, 0]) * n
        L = K + n
        v = shares[r + 1, 1] if r + 1 < rows and shares[r + 1, 0] == shares[r, 0] else 1.0
        for e in range(6):
            own, east = matrix[0, e, here : here + n], matrix[1, e, here : here + n]
            near, far, across = out[0, e, K : K + n], out[0, e, L : L + n], out[2, e, K : K + n]
            add(near, own, (1.0 - u) * (1.0 - u))
            add(far, own, u * u)
            add(across, own, u * (1.0 - u))
            add(out[1, e, K : K + n], east, (1.0 - u) * (1.0 - u))
            add(out[1, e, L : L + n], east, u * u)
            add(out[3, e, K : K + n], east, u * (1.0 - u))
            add(out[4, e, K + 1 : K + n], east, u * (1.0 - u))
            if r + 1 == rows:
                continue
            south = matrix[2, e, here : here + n]
            add(near, south, 2.0 * (1.0 - u) * (1.0 - v))
            add(far, south, 2.0 * u * v)
            add(across, south, (1.0 - u) * v + u * (1.0 - v))
            east = matrix[3, e, here : here + n]
            add(out[1, e, K : K + n], east, (1.0 - u) * (1.0 - v))
            add(out[1, e, L : L + n], east, u * v)
            add(out[3, e, K : K + n], east, (1.0 - u) * v)
            add(out[4, e, K + 1 : K + n], east, u * (1.0 - v))
            west = matrix[4, e, here + 1 : here + n]
            add(out[1, e, K : K + n], west, (1.0 - u) * (1.0 - v))
            add(out[1, e, L : L + n], west, u * v)
            add(out[4, e, K + 1 : K + n], west, (1.0 - u) * v)
            add(out[3, e, K : K + n], west, u * (1.0 - v))
        if len(second) > 0:
            for c in range(n - 2):
                s = second[here + c]
                for e in (0, 3, 5):
                    for b in (c, c + 2):
                        out[0, e, K + b] += s * (1.0 - u) * (1.0 - u)
                        out[0, e, L + b] += s * u * u
                        out[2, e, K + b] += s * u * (1.0 - u)


@njit(cache=True, nogil=True, error_model="numpy")
def add(out, values, factor):  # type: ignore[no-untyped-def]
    """``out += factor * values``, as far as both reach."""
    for a in range(min(len(out), len(values))):
        out[a] += factor * values[a]


@njit(cache=True, nogil=True, error_model="numpy")
def transpose(matrix, columns, out):  # type: ignore[no-untyped-def]
    """The same matrix with rows and columns of the grid exchanged, (5, 6, C R), into `out`."""
    rows = matrix.shape[2] // columns
    for e in range(6):
        for r in range(rows):
            for c in range(columns):
                a, b = r * columns + c, c * rows + r
                out[0, e, b] = matrix[0, e, a]
                out[1, e, b] = matrix[2, e, a]
                out[2, e, b] = matrix[1, e, a]
                out[3, e, b] = matrix[3, e, a]
                out[4, e, b] = 0.0
                # (r + 1, c - 1) sees this vertex, transposed, in its south-west.
                if r > 0 and c + 1 < columns:
                    out[4, e, b] = matrix[4, e, a - columns + 1]
