"""Banded Cholesky in single precision, for the Newton steps of the cloth, compiled.

Columns are kept in panels of eight: column j stores its rows from ``8 (j // 8)`` on, S floats, so
all vectors of a panel begin at the same row. The entry of row i and column j stands at
``A[j S + i - 8 (j // 8)]`` of the flat array. The last eight of the S floats stay zero.

Left-looking (Golub and Van Loan, Matrix Computations, 2013, section 4.2.6): a panel takes the
products of the panels before it, tile by tile in registers, and is then factored. Single precision
is enough for a search direction: gradient, energy and positions are double.
"""

from __future__ import annotations

from numba import njit

from clothrf_sapien.lanes import backward_panel, factor_panel, forward_panel, subtract_products

PANEL = 8
PADDING = 24
"""Columns are padded to a multiple of this; a panel and the unknowns of a vertex divide it."""


def band_shape(size: int, half_width: int) -> tuple[int, int]:
    """Columns of the padded matrix (a multiple of `PADDING`) and floats a column, S.

    Args:
        size: rows of the matrix.
        half_width: largest ``i - j`` of a nonzero entry.
    """
    columns = -(-size // PADDING) * PADDING
    return columns, -(-(half_width + PANEL) // PANEL) * PANEL + PANEL


@njit(cache=True, nogil=True, error_model="numpy")
def factor(A, begin, end, columns, S):  # type: ignore[no-untyped-def]
    """Replace some panels of the matrix by those of its Cholesky factor L, in place.

    The diagonal is left as its inverse. Pivots lost to round-off are replaced by huge ones: those
    unknowns stay where they are.

    Args:
        A: (columns S,) float32; lower triangle in the layout above, upper triangle of the
            diagonal blocks ignored, identity in padding columns.
        begin: first panel; those before have been factored.
        end: last panel + 1; those from there on need not be there yet.
        columns: a multiple of eight.
        S: floats a column.
    """
    blocks = S // 8 - 1
    for panel in range(begin, end):
        for i in range(0, blocks, 2):
            earlier = min(panel, blocks - 1 - i)
            if earlier <= 0:
                break
            first = panel - earlier
            source = 8 * first * S + 8 * earlier
            for j in range(0, 8, 4):
                target = (8 * panel + j) * S + 8 * i
                subtract_products(A, S, target, source + 8 * i, source + j, earlier)
        below = min(blocks - 1, columns // 8 - 1 - panel)
        factor_panel(A, S, 8 * panel * S, below)


@njit(cache=True, nogil=True, error_model="numpy")
def solve(A, columns, S, x):  # type: ignore[no-untyped-def]
    """Solve ``L L^T x = b`` in place.

    Args:
        A: as `factor` left it.
        columns: a multiple of eight.
        S: floats a column.
        x: (columns,) float32 right-hand side, replaced by the solution; zero in the padding.
    """
    panels = columns // 8
    blocks = S // 8 - 2
    for panel in range(panels):
        below = min(blocks, panels - 1 - panel)
        forward_panel(A, S, 8 * panel * S, below, x, 8 * panel)
    for panel in range(panels - 1, -1, -1):
        below = min(blocks, panels - 1 - panel)
        backward_panel(A, S, 8 * panel * S, below, x, 8 * panel)
