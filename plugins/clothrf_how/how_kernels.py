"""Compiled loop of the histogram: two passes of taps along lines of pixels, rectified, summed.

One core, 320 x 240, four orientations (31 x 31 kernels), foreground of a third of the picture:
see `bench.py` for the figures of this, of OpenCV's filter2D and of its sepFilter2D.
"""

from __future__ import annotations

import numpy as np
from numba import njit
from numpy.typing import NDArray

HALF = 0
MAGNITUDE = 1
ENERGY = 2
SATURATE8 = 3


# Contraction to fused multiply-add is allowed: the same machine always rounds alike, and the pass
# is faster. No reassociation, no assumption about NaN.
@njit(cache=True, nogil=True, fastmath={"contract"})
def _accumulate(
    row: NDArray[np.float32],
    source: NDArray[np.float32],
    y: int,
    x: int,
    dx: int,
    dy: int,
    steps: NDArray[np.int32],
    weights: NDArray[np.float32],
) -> None:
    """row[i] += sum_k weights[k] source[y + steps[k] dy, x + steps[k] dx + i], four taps a time."""
    n = row.size
    k = 0
    while k + 3 < steps.size:
        s0, s1, s2, s3 = steps[k], steps[k + 1], steps[k + 2], steps[k + 3]
        a = source[y + s0 * dy, x + s0 * dx : x + s0 * dx + n]
        b = source[y + s1 * dy, x + s1 * dx : x + s1 * dx + n]
        c = source[y + s2 * dy, x + s2 * dx : x + s2 * dx + n]
        d = source[y + s3 * dy, x + s3 * dx : x + s3 * dx + n]
        wa, wb, wc, wd = weights[k], weights[k + 1], weights[k + 2], weights[k + 3]
        for i in range(n):
            row[i] += wa * a[i] + wb * b[i] + wc * c[i] + wd * d[i]
        k += 4
    while k < steps.size:
        a = source[y + steps[k] * dy, x + steps[k] * dx : x + steps[k] * dx + n]
        wa = weights[k]
        for i in range(n):
            row[i] += wa * a[i]
        k += 1


@njit(cache=True, nogil=True)
def oriented_sums(
    padded: NDArray[np.float32],
    mask: NDArray[np.float32],
    margin: int,
    along_steps: NDArray[np.int32],
    along_weights: NDArray[np.float32],
    across_steps: NDArray[np.int32],
    across_weights: NDArray[np.float32],
    quadrature: NDArray[np.float32],
    along: tuple[int, int],
    across: tuple[int, int],
    shift: NDArray[np.int32],
    response: int,
    row_cells: NDArray[np.int32],
    column_cells: NDArray[np.int32],
    rows: int,
    columns: int,
    first: int,
    every: int,
) -> NDArray[np.float64]:
    """Rectified answers of one orientation, summed over cells of the picture.

    Args:
        padded: (H + 2 margin, W + 2 margin) float32 picture.
        mask: (H, W) float32, 1 where answers count, else 0.
        margin: pixels around the picture, at least the kernel's reach.
        along_steps: (P, n) steps of the Gaussian pass (`gabor.Factors`).
        along_weights: (P, n) its weights.
        across_steps: (P, m) steps of the wave pass.
        across_weights: (P, m) its weights.
        quadrature: (P, m) weights of the wave a quarter period on; used for `ENERGY` only.
        along: (dx, dy) of a Gaussian step.
        across: (dx, dy) of a wave step.
        shift: (P,) columns.
        response: HALF, MAGNITUDE, ENERGY or SATURATE8.
        row_cells: (H,) cell row of each picture row, ascending; negative = none.
        column_cells: (W,) cell column of each picture column; negative = none.
        rows: number of cell rows.
        columns: number of cell columns.
        first: first row that is looked at.
        every: look at every so manieth row from there; the sums are multiplied by it.

    Returns:
        (rows, columns) float64.
    """
    h, w = mask.shape
    parities = along_steps.shape[0]
    reach = 0
    for p in range(parities):
        for k in range(across_steps.shape[1]):
            reach = max(reach, abs(across_steps[p, k]))
    ex, ey = reach * abs(across[0]), reach * abs(across[1])
    smooth = np.empty((parities, h + 2 * ey, w + 2 * ex), np.float32)
    # A wave along rows needs the rows looked at only.
    start, step = (first, every) if ey == 0 else (0, 1)
    for p in range(parities):
        for y in range(start, h + 2 * ey, step):
            row = smooth[p, y]
            row[:] = np.float32(0.0)
            _accumulate(
                row,
                padded,
                margin - ey + y,
                margin - ex + shift[p],
                along[0],
                along[1],
                along_steps[p],
                along_weights[p],
            )
    result = np.zeros((rows, columns), np.float64)
    total = np.zeros(w, np.float32)
    answer = np.empty(w, np.float32)
    other = np.empty(w, np.float32)
    zero = np.float32(0.0)
    for y in range(first, h, every):
        if row_cells[y] < 0 or row_cells[y] >= rows:
            continue
        answer[:] = zero
        for p in range(parities):
            _accumulate(
                answer,
                smooth[p],
                ey + y,
                ex,
                across[0],
                across[1],
                across_steps[p],
                across_weights[p],
            )
        line = mask[y]
        if response == HALF:
            for x in range(w):
                total[x] += line[x] * max(answer[x], zero)
        elif response == MAGNITUDE:
            for x in range(w):
                total[x] += line[x] * abs(answer[x])
        elif response == SATURATE8:
            for x in range(w):
                total[x] += line[x] * min(max(answer[x], zero), np.float32(255.0))
        else:
            other[:] = zero
            for p in range(parities):
                _accumulate(
                    other,
                    smooth[p],
                    ey + y,
                    ex,
                    across[0],
                    across[1],
                    across_steps[p],
                    quadrature[p],
                )
            for x in range(w):
                total[x] += line[x] * np.sqrt(answer[x] * answer[x] + other[x] * other[x])
        if y + every >= h or row_cells[y + every] != row_cells[y]:
            for x in range(w):
                if 0 <= column_cells[x] < columns:
                    result[row_cells[y], column_cells[x]] += every * total[x]
                total[x] = zero
    return result


# Sums of a row may be added in any order (vector code); nothing assumes no NaN.
@njit(cache=True, nogil=True, fastmath={"contract", "reassoc", "nsz"})
def detrended(
    depth: NDArray[np.float32], mask: NDArray[np.bool_], degree: int
) -> NDArray[np.float32]:
    """Depth (h, w) minus its least-squares polynomial over the mask, millimetres; 0 outside.

    Args:
        depth: (h, w) float32, metres.
        mask: (h, w) bool.
        degree: 1 = plane, 2 = quadric, in pixel coordinates.
    """
    h, w = depth.shape
    n = 3 if degree == 1 else 6
    normal = np.zeros((n, n), np.float64)
    right = np.zeros(n, np.float64)
    one, zero = np.float32(1.0), np.float32(0.0)
    across = ((np.arange(w) - 0.5 * w) / w).astype(np.float32)
    for y in range(h):
        # Sums along a row of u^0 .. u^4 and of u^0 z .. u^2 z give the row's share of the matrix.
        s0 = s1 = s2 = s3 = s4 = zero
        z0 = z1 = z2 = zero
        inside, row = mask[y], depth[y]
        for x in range(w):
            m = one if inside[x] else zero
            u = m * across[x]
            z = m * row[x]
            s0 += m
            s1 += u
            s2 += u * u
            z0 += z
            z1 += u * z
            if degree == 2:
                s3 += u * u * u
                s4 += u * u * u * u
                z2 += u * u * z
        v = (y - 0.5 * h) / h
        moments = (float(s0), float(s1), float(s2), float(s3), float(s4))
        normal[0, 0] += moments[0]
        normal[0, 1] += moments[1]
        normal[0, 2] += v * moments[0]
        normal[1, 1] += moments[2]
        normal[1, 2] += v * moments[1]
        normal[2, 2] += v * v * moments[0]
        right[0] += z0
        right[1] += z1
        right[2] += v * z0
        if degree == 2:
            # Basis 1, u, v, u^2, u v, v^2.
            normal[0, 3] += moments[2]
            normal[0, 4] += v * moments[1]
            normal[0, 5] += v * v * moments[0]
            normal[1, 3] += moments[3]
            normal[1, 4] += v * moments[2]
            normal[1, 5] += v * v * moments[1]
            normal[2, 3] += v * moments[2]
            normal[2, 4] += v * v * moments[1]
            normal[2, 5] += v * v * v * moments[0]
            normal[3, 3] += moments[4]
            normal[3, 4] += v * moments[3]
            normal[3, 5] += v * v * moments[2]
            normal[4, 4] += v * v * moments[2]
            normal[4, 5] += v * v * v * moments[1]
            normal[5, 5] += v * v * v * v * moments[0]
            right[3] += z2
            right[4] += v * z1
            right[5] += v * v * z0
    for i in range(n):
        # A little weight on the diagonal: a foreground of one line has no plane, but an answer.
        normal[i, i] += 1e-9 * (normal[0, 0] + 1.0)
        for j in range(i):
            normal[i, j] = normal[j, i]
    c = np.linalg.solve(normal, right)
    result = np.empty((h, w), np.float32)
    for y in range(h):
        v = (y - 0.5 * h) / h
        a = c[0] + c[2] * v
        b = c[1]
        q = 0.0
        if degree == 2:
            a += c[5] * v * v
            b += c[4] * v
            q = c[3]
        base, slope, bend = np.float32(a), np.float32(b), np.float32(q)
        inside, row, line = mask[y], depth[y], result[y]
        for x in range(w):
            u = across[x]
            value = np.float32(1000.0) * (row[x] - (base + u * (slope + u * bend)))
            line[x] = value if inside[x] else zero
    return result
