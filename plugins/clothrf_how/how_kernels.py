"""Compiled loop of the histogram: two passes of taps along lines of pixels, rectified, summed.

One core, 320 x 240, four orientations (31 x 31 kernels), foreground of a third of the picture:
see `bench.py` for the figures of this, of OpenCV's filter2D and of its sepFilter2D.
"""

from __future__ import annotations

import numpy as np
from numba import njit
from numpy.typing import NDArray

from clothrf_how.lanes import LANES, add_taps

HALF = 0
MAGNITUDE = 1
ENERGY = 2
SATURATE8 = 3


@njit(cache=True, nogil=True)
def framed(
    picture: NDArray[np.float32],
    mask: NDArray[np.bool_],
    box: tuple[int, int, int, int],
    margin: int,
    wide: int,
) -> tuple[NDArray[np.float32], NDArray[np.float32]]:
    """What `oriented_sums` wants of a picture's box: with a frame around it, and 1 where it counts.

    Args:
        picture: (H, W) float32; zeros are taken beyond it.
        mask: (H, W) bool.
        box: half-open (x0, y0, x1, y1), h x w pixels.
        margin: pixels around the box.
        wide: w or more, a multiple of `LANES`.

    Returns:
        (h + 2 margin, wide + 2 margin + LANES) and (h, wide) float32.
    """
    x0, y0, x1, y1 = box
    one, zero = np.float32(1.0), np.float32(0.0)
    around = np.zeros((y1 - y0 + 2 * margin, wide + 2 * margin + LANES), np.float32)
    counts = np.zeros((y1 - y0, wide), np.float32)
    left, right = max(0, x0 - margin), min(picture.shape[1], x1 + margin)
    for y in range(max(0, y0 - margin), min(picture.shape[0], y1 + margin)):
        line = around[y - y0 + margin, left - x0 + margin : right - x0 + margin]
        row = picture[y, left:right]
        for i in range(right - left):
            line[i] = row[i]
    for y in range(y0, y1):
        line, inside = counts[y - y0], mask[y, x0:x1]
        for i in range(x1 - x0):
            line[i] = one if inside[i] else zero
    return around, counts


@njit(cache=True, nogil=True)
def _flat(
    steps: NDArray[np.int32],
    weights: NDArray[np.float32],
    dx: int,
    dy: int,
    stride: int,
    beyond: int,
) -> tuple[NDArray[np.int64], NDArray[np.float32]]:
    """Offsets in a flat picture, and weights, of the (P, n) taps that weigh anything.

    Args:
        steps: (P, n) steps.
        weights: (P, n).
        dx: columns of a step.
        dy: rows of a step.
        stride: floats a row.
        beyond: floats from one parity's picture to the next one's.
    """
    offsets = np.empty(steps.size, np.int64)
    factors = np.empty(steps.size, np.float32)
    n = 0
    for p in range(steps.shape[0]):
        for k in range(steps.shape[1]):
            if weights[p, k] != 0.0:
                offsets[n] = p * beyond + steps[p, k] * (dy * stride + dx)
                factors[n] = weights[p, k]
                n += 1
    return offsets[:n].copy(), factors[:n].copy()


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
        padded: (H + 2 margin, W + 2 margin + LANES) float32 picture.
        mask: (H, W) float32, 1 where answers count, else 0; W a multiple of `LANES`.
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
    wide = -(-(w + 2 * ex) // LANES) * LANES
    smooth = np.empty((parities, h + 2 * ey, wide), np.float32)
    # A wave along rows needs the rows looked at only.
    start, step = (first, every) if ey == 0 else (0, 1)
    flat, row_size = padded.reshape(-1), padded.shape[1]
    smooths, size = smooth.reshape(-1), smooth.shape[1] * wide
    for p in range(parities):
        offsets, weights = _flat(
            along_steps[p : p + 1], along_weights[p : p + 1], along[0], along[1], row_size, 0
        )
        for y in range(start, h + 2 * ey, step):
            at = (margin - ey + y) * row_size + margin - ex + shift[p]
            add_taps(
                smooths,
                p * size + y * wide,
                wide // LANES,
                flat,
                at,
                offsets,
                weights,
                len(weights),
            )
    waves, wave_weights = _flat(across_steps, across_weights, across[0], across[1], wide, size)
    turned, turned_weights = _flat(across_steps, quadrature, across[0], across[1], wide, size)
    result = np.zeros((rows, columns), np.float64)
    total = np.zeros(w, np.float32)
    answer = np.empty(w, np.float32)
    other = np.empty(w, np.float32)
    zero = np.float32(0.0)
    for y in range(first, h, every):
        if row_cells[y] < 0 or row_cells[y] >= rows:
            continue
        at = (ey + y) * wide + ex
        add_taps(answer, 0, w // LANES, smooths, at, waves, wave_weights, len(waves))
        line = mask[y]
        if response == HALF:
            for x in range(w):
                total[x] += line[x] * (answer[x] if answer[x] > zero else zero)
        elif response == MAGNITUDE:
            for x in range(w):
                total[x] += line[x] * abs(answer[x])
        elif response == SATURATE8:
            for x in range(w):
                total[x] += line[x] * min(max(answer[x], zero), np.float32(255.0))
        else:
            add_taps(other, 0, w // LANES, smooths, at, turned, turned_weights, len(turned))
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
    depth: NDArray[np.float32],
    mask: NDArray[np.bool_],
    degree: int,
    box: tuple[int, int, int, int],
) -> NDArray[np.float32]:
    """Depth (h, w) minus its least-squares polynomial over the mask, millimetres; 0 outside.

    Args:
        depth: (h, w) float32, metres.
        mask: (h, w) bool.
        degree: 1 = plane, 2 = quadric, in pixel coordinates.
        box: half-open (x0, y0, x1, y1) that holds the mask.
    """
    x0, y0, x1, y1 = box
    h, w = y1 - y0, x1 - x0
    n = 3 if degree == 1 else 6
    normal = np.zeros((n, n), np.float64)
    right = np.zeros(n, np.float64)
    one, zero = np.float32(1.0), np.float32(0.0)
    across = ((np.arange(w) - 0.5 * w) / w).astype(np.float32)
    for y in range(h):
        # Sums along a row of u^0 .. u^4 and of u^0 z .. u^2 z give the row's share of the matrix.
        s0 = s1 = s2 = s3 = s4 = zero
        z0 = z1 = z2 = zero
        inside, row = mask[y0 + y, x0:x1], depth[y0 + y, x0:x1]
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
    result = np.zeros(depth.shape, np.float32)
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
        inside, row = mask[y0 + y, x0:x1], depth[y0 + y, x0:x1]
        line = result[y0 + y, x0:x1]
        for x in range(w):
            u = across[x]
            value = np.float32(1000.0) * (row[x] - (base + u * (slope + u * bend)))
            line[x] = value if inside[x] else zero
    return result
