"""Compiled loops of the foreground: block reduction, connected surfaces, bridged holes."""

from __future__ import annotations

from typing import Any

import numpy as np
from numba import njit
from numpy.typing import NDArray

# States of a working pixel.
UNMEASURED = 0
CANDIDATE = 1
ELSEWHERE = 2
ODD = 3

# Depths of one 2 x 2 block that are this close to its nearest are averaged, metres; across an edge
# the mean of near and far would be a point in the air.
BLOCK = np.float32(0.015)

# Pieces of the picture meet across this many pixels: depth is missing along edges.
GAP = 4


# Both reductions are written without branches (every condition is a select), so that the loop over
# a row becomes vector code: 0.19 ms instead of 1.06 ms for 640 x 480 as nested ifs. "numpy" errors:
# a division by zero is thrown away by the select after it, it must not raise.
@njit(cache=True, nogil=True, error_model="numpy")
def reduce_pairs(
    depth: NDArray[np.float32],
    near: float,
    far: float,
    directions: NDArray[np.float32],
    origin: NDArray[np.float32],
    low: NDArray[np.float32],
    high: NDArray[np.float32],
) -> tuple[NDArray[np.float32], NDArray[np.uint8]]:
    """Depth (h, w) of 2 x 2 blocks, 0 = not measured, and the state of each block.

    A block's depth is the mean of its depths that are within `BLOCK` of the nearest one in
    [near, far], or the largest one if none is; it is a candidate if one is and its world point
    ``origin + depth * direction`` lies in the box.

    Args:
        depth: (2 h or more, 2 w or more) float32, metres; NaN, infinite, zero and negative = not
            measured.
        near: least depth, metres.
        far: largest depth, metres.
        directions: (3, h, w) float32 world direction of each block's ray, of unit depth.
        origin: (3,) float32 camera centre, world.
        low: (3,) float32 corner of the workspace box, world.
        high: (3,) float32, the opposite corner.
    """
    _, h, w = directions.shape
    z = np.empty((h, w), np.float32)
    state = np.empty((h, w), np.uint8)
    lo, hi = np.float32(near), np.float32(far)
    inf, zero, one = np.float32(np.inf), np.float32(0.0), np.float32(1.0)
    for y in range(h):
        top, bottom = depth[2 * y], depth[2 * y + 1]
        line, kind = z[y], state[y]
        dx, dy, dz = directions[0, y], directions[1, y], directions[2, y]
        for x in range(w):
            a, b, c, d = top[2 * x], top[2 * x + 1], bottom[2 * x], bottom[2 * x + 1]
            na = a if (a >= lo) & (a <= hi) else inf
            nb = b if (b >= lo) & (b <= hi) else inf
            nc = c if (c >= lo) & (c <= hi) else inf
            nd = d if (d >= lo) & (d <= hi) else inf
            ab = na if na < nb else nb
            cd = nc if nc < nd else nd
            nearest = ab if ab < cd else cd
            limit = nearest + BLOCK
            total = na if (na <= limit) & (na < inf) else zero
            count = one if (na <= limit) & (na < inf) else zero
            total += nb if (nb <= limit) & (nb < inf) else zero
            count += one if (nb <= limit) & (nb < inf) else zero
            total += nc if (nc <= limit) & (nc < inf) else zero
            count += one if (nc <= limit) & (nc < inf) else zero
            total += nd if (nd <= limit) & (nd < inf) else zero
            count += one if (nd <= limit) & (nd < inf) else zero
            fa = a if (a > zero) & (a < inf) else zero
            fb = b if (b > zero) & (b < inf) else zero
            fc = c if (c > zero) & (c < inf) else zero
            fd = d if (d > zero) & (d < inf) else zero
            ab = fa if fa > fb else fb
            cd = fc if fc > fd else fd
            farthest = ab if ab > cd else cd
            mean = total / count
            value = mean if count > zero else farthest
            px = origin[0] + value * dx[x]
            py = origin[1] + value * dy[x]
            pz = origin[2] + value * dz[x]
            inside = (px >= low[0]) & (px <= high[0]) & (py >= low[1]) & (py <= high[1])
            inside = inside & (pz >= low[2]) & (pz <= high[2]) & (count > zero)
            line[x] = value
            measured = np.uint8(ELSEWHERE) if value > zero else np.uint8(UNMEASURED)
            kind[x] = np.uint8(CANDIDATE) if inside else measured
    return z, state


@njit(cache=True, nogil=True)
def reduce_pixels(
    depth: NDArray[np.float32],
    near: float,
    far: float,
    directions: NDArray[np.float32],
    origin: NDArray[np.float32],
    low: NDArray[np.float32],
    high: NDArray[np.float32],
) -> tuple[NDArray[np.float32], NDArray[np.uint8]]:
    """`reduce_pairs` with blocks of one pixel."""
    _, h, w = directions.shape
    z = np.empty((h, w), np.float32)
    state = np.empty((h, w), np.uint8)
    lo, hi = np.float32(near), np.float32(far)
    inf, zero = np.float32(np.inf), np.float32(0.0)
    for y in range(h):
        row, line, kind = depth[y], z[y], state[y]
        dx, dy, dz = directions[0, y], directions[1, y], directions[2, y]
        for x in range(w):
            a = row[x]
            value = a if (a > zero) & (a < inf) else zero
            px = origin[0] + value * dx[x]
            py = origin[1] + value * dy[x]
            pz = origin[2] + value * dz[x]
            inside = (px >= low[0]) & (px <= high[0]) & (py >= low[1]) & (py <= high[1])
            inside = inside & (pz >= low[2]) & (pz <= high[2])
            inside = inside & (value >= lo) & (value <= hi) & (value > zero)
            line[x] = value
            measured = np.uint8(ELSEWHERE) if value > zero else np.uint8(UNMEASURED)
            kind[x] = np.uint8(CANDIDATE) if inside else measured
    return z, state


# Sum of r, g, b below which a pixel has no colour to speak of, and bins of a chromaticity.
DARK = 36
BINS = 256
# A cloth's own colours spread: five median deviations are taken as its own, this at the least.
LEAST_SPREAD = np.float32(0.025)


@njit(cache=True, nogil=True)
def odd_colours(
    state: NDArray[np.uint8], rgb: NDArray[np.uint8], factor: int, tolerance: float
) -> int:
    """Mark as `ODD`, in place, candidates that differ in colour from most of them.

    Colour is the chromaticity (r, g) / (r + g + b), which shading does not change; "most of them"
    is its median over the candidates. Hands, arms and grippers that touch the cloth go this way.
    Nothing happens where colours say nothing: dark pictures, or a cloth of many colours (less than
    half of the candidates agree). How far is different depends on how much the cloth's own
    pixels scatter, up to `tolerance`.

    Args:
        state: (h, w) uint8.
        rgb: (factor h or more, factor w or more, 3) uint8; a block's first pixel stands for it.
        factor: picture pixels along a block's side.
        tolerance: of each of the two chromaticities.

    Returns:
        Number of candidates marked.
    """
    h, w = state.shape
    red = np.zeros(BINS, np.int64)
    green = np.zeros(BINS, np.int64)
    seen = bright = 0
    # Every third pixel of every third row is enough for a median.
    for y in range(0, h, 3):
        for x in range(0, w, 3):
            if state[y, x] != CANDIDATE:
                continue
            seen += 1
            r = int(rgb[y * factor, x * factor, 0])
            g = int(rgb[y * factor, x * factor, 1])
            total = r + g + int(rgb[y * factor, x * factor, 2])
            if total >= DARK:
                bright += 1
                red[min(BINS * r // total, BINS - 1)] += 1
                green[min(BINS * g // total, BINS - 1)] += 1
    if 2 * bright <= seen:
        return 0
    middle_red, middle_green = _median(red, bright), _median(green, bright)
    red[:] = 0
    for y in range(0, h, 3):
        for x in range(0, w, 3):
            if state[y, x] != CANDIDATE:
                continue
            r = int(rgb[y * factor, x * factor, 0])
            g = int(rgb[y * factor, x * factor, 1])
            total = r + g + int(rgb[y * factor, x * factor, 2])
            if total >= DARK:
                t = np.float32(total)
                off_red = abs(np.float32(r) / t - middle_red)
                off_green = abs(np.float32(g) / t - middle_green)
                red[min(int(np.float32(BINS) * max(off_red, off_green)), BINS - 1)] += 1
    own = np.float32(5.0) * _median(red, bright)
    width = np.float32(tolerance)
    spread = own if own > LEAST_SPREAD else LEAST_SPREAD
    if spread < width:
        width = spread
    # Four counts of slack for the rounding of dark pixels.
    slack = np.float32(4.0)
    many = agree = 0
    for y in range(h):
        for x in range(w):
            if state[y, x] != CANDIDATE:
                continue
            r = int(rgb[y * factor, x * factor, 0])
            g = int(rgb[y * factor, x * factor, 1])
            total = r + g + int(rgb[y * factor, x * factor, 2])
            if total < DARK:
                continue
            t = np.float32(total)
            limit = width * t + slack
            if (
                abs(np.float32(r) - middle_red * t) > limit
                or abs(np.float32(g) - middle_green * t) > limit
            ):
                state[y, x] = ODD
                many += 1
            else:
                agree += 1
    if agree > many:
        return many
    for y in range(h):
        for x in range(w):
            if state[y, x] == ODD:
                state[y, x] = CANDIDATE
    return 0


@njit(cache=True, nogil=True)
def _median(histogram: NDArray[np.int64], total: int) -> np.float32:
    """Median of a histogram over [0, 1], linear within its bin."""
    below = 0
    for i in range(histogram.size):
        if 2 * (below + histogram[i]) >= total:
            inside = (0.5 * total - below) / histogram[i]
            return np.float32((i + inside) / histogram.size)
        below += histogram[i]
    return np.float32(1.0)


@njit(cache=True, nogil=True)
def _root(parent: NDArray[np.int32], a: int) -> int:
    while parent[a] != a:
        parent[a] = parent[parent[a]]
        a = parent[a]
    return a


@njit(cache=True, nogil=True)
def surfaces(
    z: NDArray[np.float32], state: NDArray[np.uint8], jump: float, wanted: int
) -> tuple[NDArray[np.int32], NDArray[np.int32]]:
    """Connected surfaces: 4-neighbours in state `wanted` and closer than `jump` in depth.

    Two passes with union-find (Rosenfeld and Pfaltz 1966).

    Returns:
        (h, w) int32 label, 0 = none, numbered from 1 by first pixel in reading order; and the
        area in pixels of each label, (labels + 1,) int32.
    """
    h, w = z.shape
    label = np.zeros((h, w), np.int32)
    parent = np.zeros(h * w // 2 + 2, np.int32)
    limit = np.float32(jump)
    fresh = 1
    for y in range(h):
        for x in range(w):
            if state[y, x] != wanted:
                continue
            d = z[y, x]
            left = 0
            if x > 0 and label[y, x - 1] > 0 and abs(d - z[y, x - 1]) < limit:
                left = label[y, x - 1]
            up = 0
            if y > 0 and label[y - 1, x] > 0 and abs(d - z[y - 1, x]) < limit:
                up = label[y - 1, x]
            if left == 0 and up == 0:
                if fresh == parent.size:
                    grown = np.zeros(2 * parent.size, np.int32)
                    grown[: parent.size] = parent
                    parent = grown
                parent[fresh] = fresh
                label[y, x] = fresh
                fresh += 1
            elif left == 0 or left == up:
                label[y, x] = up
            elif up == 0:
                label[y, x] = left
            else:
                a = _root(parent, left)
                b = _root(parent, up)
                label[y, x] = min(a, b)
                parent[max(a, b)] = min(a, b)
    final = np.zeros(fresh, np.int32)
    number = 0
    for a in range(1, fresh):
        r = _root(parent, a)
        if r == a:
            number += 1
            final[a] = number
        else:
            final[a] = final[r]
    area = np.zeros(number + 1, np.int32)
    for y in range(h):
        for x in range(w):
            if label[y, x] > 0:
                n = final[label[y, x]]
                label[y, x] = n
                area[n] += 1
    return label, area


@njit(cache=True, nogil=True)
def apart(
    label: NDArray[np.int32],
    area: NDArray[np.int32],
    z: NDArray[np.float32],
    main: int,
    least: int,
    jump: float,
) -> NDArray[np.int64]:
    """(labels, 2): how often each piece is `jump` from `main` in depth, and meets it at all.

    They meet where a pixel of a piece of at least `least` pixels and one of `main` are at most
    `GAP` apart in a row or a column.
    """
    h, w = label.shape
    count = np.zeros((area.size, 2), np.int64)
    for y in range(h):
        for x in range(w):
            n = label[y, x]
            if n == 0 or n == main or area[n] < least:
                continue
            for k in range(4):
                for step in range(1, GAP + 1):
                    j = y + (step if k == 0 else (-step if k == 1 else 0))
                    i = x + (step if k == 2 else (-step if k == 3 else 0))
                    if not (0 <= j < h and 0 <= i < w):
                        break
                    if label[j, i] == main:
                        count[n, 1] += 1
                        if abs(z[j, i] - z[y, x]) > jump:
                            count[n, 0] += 1
                        break
    return count


@njit(cache=True, nogil=True)
def bounds(mask: NDArray[np.bool_]) -> tuple[int, int, int, int]:
    """Half-open (x0, y0, x1, y1) of the true pixels; zeros if there are none."""
    h, w = mask.shape
    x0, y0, x1, y1 = w, h, 0, 0
    for y in range(h):
        first = 0
        while first < w and not mask[y, first]:
            first += 1
        if first == w:
            continue
        last = w - 1
        while not mask[y, last]:
            last -= 1
        x0, x1 = min(x0, first), max(x1, last + 1)
        y0, y1 = min(y0, y), y + 1
    return (x0, y0, x1, y1) if y1 > 0 else (0, 0, 0, 0)


@njit(cache=True, nogil=True)
def _across(
    z: NDArray[np.float32],
    depth: NDArray[np.float32],
    y: int,
    x: int,
    dy: int,
    dx: int,
    n: int,
    limit: np.float32,
    full: NDArray[np.bool_],
) -> None:
    """Fill the n pixels before (y, x), going back by (dy, dx), unless one looks past the cloth."""
    a = depth[y - (n + 1) * dy, x - (n + 1) * dx]
    rise = depth[y, x] - a
    if abs(rise) > limit:
        return
    slope = rise / np.float32(n + 1)
    for i in range(1, n + 1):
        k = n + 1 - i
        if z[y - k * dy, x - k * dx] > a + slope * np.float32(i) + limit:
            return
    for i in range(1, n + 1):
        k = n + 1 - i
        full[y - k * dy, x - k * dx] = True
        depth[y - k * dy, x - k * dx] = a + slope * np.float32(i)


@njit(cache=True, nogil=True)
def bridge(
    mask: NDArray[np.bool_], z: NDArray[np.float32], gap: int, jump: float
) -> tuple[NDArray[np.bool_], NDArray[np.float32]]:
    """Mask and depth with holes of up to `gap` pixels filled along rows, then along columns.

    A run of pixels between two foreground pixels is filled by linear interpolation unless
    something is measured `jump` behind it there: then one really looks past the cloth.

    Returns:
        (h, w) bool; (h, w) float32 metres, 0 outside the mask.
    """
    h, w = mask.shape
    full = mask.copy()
    depth = np.empty((h, w), np.float32)
    zero = np.float32(0.0)
    for y in range(h):
        row, inside, line = z[y], mask[y], depth[y]
        for x in range(w):
            line[x] = row[x] if inside[x] else zero
    x0, y0, x1, y1 = bounds(mask)
    limit = np.float32(jump)
    for y in range(y0, y1):
        last = w
        for x in range(x0, x1):
            if mask[y, x]:
                n = x - last - 1
                if 0 < n <= gap:
                    _across(z, depth, y, x, 0, 1, n, limit, full)
                last = x
    rows = full.copy()
    below = np.full(w, h, np.int32)
    for y in range(y0, y1):
        for x in range(x0, x1):
            if rows[y, x]:
                n = y - below[x] - 1
                if 0 < n <= gap:
                    _across(z, depth, y, x, 1, 0, n, limit, full)
                below[x] = y
    return full, depth


# Sums of a row may be added in any order: vector code.
@njit(cache=True, nogil=True, fastmath={"contract", "reassoc", "nsz"})
def sums(
    mask: NDArray[np.bool_], depth: NDArray[np.float32], box: tuple[int, int, int, int]
) -> tuple[int, float, float, float]:
    """Pixels of a mask, and the sums of their columns, rows and depths; depth is 0 outside."""
    x0, y0, x1, y1 = box
    area = 0
    u = v = z = 0.0
    for y in range(y0, y1):
        inside, row = mask[y, x0:x1], depth[y, x0:x1]
        count = np.int32(0)
        columns = np.int32(0)
        total = np.float32(0.0)
        for i in range(x1 - x0):
            one = np.int32(1) if inside[i] else np.int32(0)
            count += one
            columns += one * np.int32(i)
            total += row[i]
        area += int(count)
        u += float(columns) + x0 * float(count)
        v += y * float(count)
        z += float(total)
    return area, u, v, z


def warm() -> Any:
    """Compile (or load from the cache) every kernel, so that the first frame is not late."""
    one = np.zeros((2, 2), np.float32)
    ends = np.zeros(3, np.float32)
    reduce_pairs(one, 0.1, 1.0, np.zeros((3, 1, 1), np.float32), ends, ends, ends)
    z, state = reduce_pixels(one, 0.1, 1.0, np.zeros((3, 2, 2), np.float32), ends, ends, ends)
    odd_colours(state, np.zeros((2, 2, 3), np.uint8), 1, 0.1)
    label, area = surfaces(z, state, 0.1, CANDIDATE)
    apart(label, area, z, 1, 1, 0.1)
    return sums(*bridge(state > 0, z, 1, 0.1), (0, 0, 2, 2))
