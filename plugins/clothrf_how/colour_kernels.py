"""Compiled loops over colour: what colour the cloth has, what differs, and what shares it."""

from __future__ import annotations

from typing import NamedTuple

import numpy as np
from numba import njit
from numpy.typing import NDArray

from clothrf_how.foreground_kernels import CANDIDATE, GROWN, ODD, UNMEASURED, stepped
from clothrf_how.histogram import median_bin

# Shades of a working pixel: no colour to speak of, the cloth's colour, another one.
UNTOLD = 0
OWN = 1
OTHER = 2

# Sum of r, g, b below which a pixel has no colour to speak of, and bins of a chromaticity.
DARK = 36
BINS = 256
# A cloth's own colours spread: five median deviations are taken as its own, this at the least.
LEAST_SPREAD = np.float32(0.025)
# Counts of slack for the rounding of dark pixels.
SLACK = np.float32(4.0)
# Pixels from the mask up to which a grown pixel's depth is as good as measured.
NEAR = 2
# Every so many rows and columns are enough for a median.
EVERY = 4
# A growth that has not ended after `reach` pixels covers the background.
ALIVE = 0.02


class Colour(NamedTuple):
    """The cloth's colour as a chromaticity (r, g) / (r + g + b), which shading does not change.

    Attributes:
        red: of the median candidate.
        green: the same.
        width: how far the cloth's own pixels are from it; 0 = colours say nothing.
    """

    red: np.float32
    green: np.float32
    width: np.float32


@njit(cache=True, nogil=True)
def cloth_colour(
    state: NDArray[np.uint8],
    rgb: NDArray[np.uint8],
    factor: int,
    tolerance: float,
    box: tuple[int, int, int, int],
) -> Colour:
    """The median chromaticity of the candidates, and how much they scatter, up to `tolerance`.

    Args:
        state: (h, w) uint8.
        rgb: (factor h or more, factor w or more, 3) uint8; a block's first pixel stands for it.
        factor: picture pixels along a block's side.
        tolerance: of each of the two chromaticities.
        box: half-open (x0, y0, x1, y1) that holds all candidates.
    """
    x0, y0, x1, y1 = box
    left, top = -(-x0 // EVERY) * EVERY, -(-y0 // EVERY) * EVERY
    red = np.zeros(BINS, np.int64)
    green = np.zeros(BINS, np.int64)
    most = max(-(-(y1 - top) // EVERY) * -(-(x1 - left) // EVERY), 1)
    reds, greens = np.empty(most, np.float32), np.empty(most, np.float32)
    seen = bright = 0
    bins, last = np.float32(BINS), np.float32(BINS - 1)
    for y in range(top, y1, EVERY):
        line, kind = rgb[y * factor], state[y]
        for x in range(left, x1, EVERY):
            if kind[x] != CANDIDATE:
                continue
            seen += 1
            at = np.uint64(x * factor)
            r, g = np.float32(line[at, 0]), np.float32(line[at, 1])
            total = r + g + np.float32(line[at, 2])
            if total >= DARK:
                reds[bright], greens[bright] = r / total, g / total
                red[int(min(bins * reds[bright], last))] += 1
                green[int(min(bins * greens[bright], last))] += 1
                bright += 1
    zero = np.float32(0.0)
    if 2 * bright <= seen or tolerance <= 0.0:
        return Colour(zero, zero, zero)
    middle_red = np.float32(median_bin(red, bright) / BINS)
    middle_green = np.float32(median_bin(green, bright) / BINS)
    red[:] = 0
    for i in range(bright):
        off = max(abs(reds[i] - middle_red), abs(greens[i] - middle_green))
        red[int(min(bins * off, last))] += 1
    own = max(np.float32(5.0) * np.float32(median_bin(red, bright) / BINS), LEAST_SPREAD)
    return Colour(middle_red, middle_green, min(own, np.float32(tolerance)))


@njit(cache=True, nogil=True)
def shades(
    rgb: NDArray[np.uint8],
    factor: int,
    colour: Colour,
    shape: tuple[int, int],
    rows: tuple[int, int],
) -> NDArray[np.uint8]:
    """(h, w) uint8 `UNTOLD`, `OWN` or `OTHER`: which blocks have the cloth's colour.

    Args:
        rgb: (factor h or more, factor w or more, 3) uint8; a block's first pixel stands for it.
        factor: picture pixels along a block's side.
        colour: the cloth's.
        shape: (h, w).
        rows: half-open range of rows that are asked for; the others are `UNTOLD`.
    """
    h, w = shape
    result = np.zeros((h, w), np.uint8)
    r8, g8, b8 = np.empty(w, np.uint8), np.empty(w, np.uint8), np.empty(w, np.uint8)
    red, green, width = colour
    untold, own, other = np.uint8(UNTOLD), np.uint8(OWN), np.uint8(OTHER)
    dark = np.float32(DARK)
    for y in range(max(rows[0], 0), min(rows[1], h)):
        line, shade = rgb[y * factor].reshape(-1), result[y]
        # Colours apart first, and one stride known when compiling: only then is it vector code.
        if factor == 2:
            for i in range(w):
                r8[i] = line[6 * i]
            for i in range(w):
                g8[i] = line[6 * i + 1]
            for i in range(w):
                b8[i] = line[6 * i + 2]
        else:
            for i in range(w):
                at = 3 * factor * i
                r8[i], g8[i], b8[i] = line[at], line[at + 1], line[at + 2]
        for i in range(w):
            r, g = np.float32(r8[i]), np.float32(g8[i])
            t = r + g + np.float32(b8[i])
            limit = width * t + SLACK
            far = (abs(r - red * t) > limit) | (abs(g - green * t) > limit)
            told = other if far else own
            shade[i] = untold if t < dark else told
    return result


@njit(cache=True, nogil=True)
def mark_odd(
    state: NDArray[np.uint8], shade: NDArray[np.uint8], box: tuple[int, int, int, int]
) -> tuple[int, int]:
    """Mark as `ODD`, in place, candidates of another colour than the cloth's.

    Hands, arms and grippers that touch the cloth go this way. Nothing is marked where colours say
    nothing: a cloth of many colours, less than half of whose candidates agree.

    Args:
        state: (h, w) uint8.
        shade: (h, w) uint8 of `shades`.
        box: half-open (x0, y0, x1, y1) that holds all candidates.

    Returns:
        Candidates of the cloth's colour, and of another one.
    """
    x0, y0, x1, y1 = box
    agree = differ = 0
    candidate, odd = np.uint8(CANDIDATE), np.uint8(ODD)
    own, other = np.uint8(OWN), np.uint8(OTHER)
    for y in range(y0, y1):
        kind, told = state[y, x0:x1], shade[y, x0:x1]
        same, different = np.int32(0), np.int32(0)
        for i in range(x1 - x0):
            here = kind[i] == candidate
            same += np.int32(here & (told[i] == own))
            different += np.int32(here & (told[i] == other))
        agree += int(same)
        differ += int(different)
    if agree > differ > 0:
        for y in range(y0, y1):
            kind, told = state[y, x0:x1], shade[y, x0:x1]
            for i in range(x1 - x0):
                kind[i] = odd if (kind[i] == candidate) & (told[i] == other) else kind[i]
    return agree, differ


@njit(cache=True, nogil=True)
def likeness(state: NDArray[np.uint8], shade: NDArray[np.uint8]) -> float:
    """How much of what may not be cloth has the cloth's colour: a share."""
    h, w = state.shape
    alike = others = 0
    candidate, own = np.uint8(CANDIDATE), np.uint8(OWN)
    for y in range(h):
        kind, row = state[y], shade[y]
        same, many = np.int32(0), np.int32(0)
        for x in range(w):
            behind = kind[x] != candidate
            same += np.int32(behind & (row[x] == own))
            many += np.int32(behind)
        alike += int(same)
        others += int(many)
    return alike / max(others, 1)


@njit(cache=True, nogil=True)
def complete(
    mask: NDArray[np.bool_],
    depth: NDArray[np.float32],
    z: NDArray[np.float32],
    state: NDArray[np.uint8],
    shade: NDArray[np.uint8],
    label: NDArray[np.int32],
    large: NDArray[np.bool_],
    jump: float,
    stand_off: float,
    reach: int,
    box: tuple[int, int, int, int],
) -> tuple[int, int, int, int]:
    """Grow the cloth, in place, over pixels of its colour that a sensor lost or tore off.

    Pixel by pixel outwards from the mask, up to `reach` pixels far. A pixel's depth is that of the
    one it is reached from, or follows what is measured there by at most `jump` a pixel. Where the
    growth has not come to an end by then the background has the cloth's colour, and nothing is
    grown.

    Args:
        mask: (h, w) bool, changed.
        depth: (h, w) float32 metres, 0 outside the mask, changed.
        z: (h, w) float32 measured depth, 0 = none.
        state: (h, w) uint8, changed: `GROWN` where nothing is measured nearby.
        shade: (h, w) uint8 of `shades`.
        label: (h, w) int32 pieces, 0 = none.
        large: (labels + 1,) bool, pieces that are not grown over: what they are was decided.
        jump: metres a pixel.
        stand_off: metres; what is measured farther off than this is something else.
        reach: pixels.
        box: half-open (x0, y0, x1, y1) that holds the mask.

    Returns:
        The half-open box that holds the mask now.
    """
    limit, off = np.float32(jump), np.float32(stand_off)
    h, w = mask.shape
    x0, y0, x1, y1 = box
    front = np.empty((h * w, 2), np.int32)
    given = (depth, z, shade, label, large, limit, off, front)
    area = grown = 0
    bits = mask.view(np.uint8)
    # The rim of a row, eight pixels to a word: most of it is empty.
    rim = np.zeros(-(-w // 8) * 8, np.uint8)
    words = rim.view(np.uint64)
    one = np.uint8(1)
    for y in range(y0, y1):
        row, above, below = bits[y], bits[max(y - 1, 0)], bits[min(y + 1, h - 1)]
        middle, left, right = row[1 : w - 1], row[: w - 2], row[2:]
        up, down, edge = above[1 : w - 1], below[1 : w - 1], rim[1 : w - 1]
        many = np.int32(row[0]) + np.int32(row[w - 1])
        for x in range(w - 2):
            edge[x] = middle[x] & (one ^ (left[x] & right[x] & up[x] & down[x]))
            many += np.int32(middle[x])
        if many == 0:
            continue
        area += int(many)
        rim[0] = row[0] & (one ^ (row[1] & above[0] & below[0]))
        rim[w - 1] = row[w - 1] & (one ^ (row[w - 2] & above[w - 1] & below[w - 1]))
        for word in range(words.size):
            if words[word] == 0:
                continue
            for x in range(8 * word, min(8 * word + 8, w)):
                if rim[x]:
                    grown = _reached(y, x, grown, *given)
    start, end, far = 0, grown, grown
    for level in range(1, reach):
        if start == end:
            break
        for n in range(start, end):
            y, x = front[n, 0], front[n, 1]
            grown = _reached(y, x, grown, *given)
        start, end = end, grown
        if level < NEAR:
            far = grown
    if end - start > ALIVE * area or grown > 2 * area:
        for n in range(grown):
            depth[front[n, 0], front[n, 1]] = np.float32(0.0)
        return box
    for n in range(grown):
        y, x = front[n, 0], front[n, 1]
        mask[y, x] = True
        if n >= far and state[y, x] == UNMEASURED:
            state[y, x] = GROWN
        x0, y0, x1, y1 = min(x0, x), min(y0, y), max(x1, x + 1), max(y1, y + 1)
    return x0, y0, x1, y1


@njit(cache=True, nogil=True)
def _reached(
    y: int,
    x: int,
    grown: int,
    depth: NDArray[np.float32],
    z: NDArray[np.float32],
    shade: NDArray[np.uint8],
    label: NDArray[np.int32],
    large: NDArray[np.bool_],
    limit: np.float32,
    off: np.float32,
    front: NDArray[np.int32],
) -> int:
    """Give the neighbours of (y, x) a depth and append them to the front; its length then."""
    h, w = shade.shape
    for k in range(4):
        j, i = stepped(y, x, k, 1)
        if not (0 <= j < h and 0 <= i < w) or shade[j, i] != OWN or depth[j, i] > 0.0:
            continue
        here, there = depth[y, x], z[j, i]
        if large[label[j, i]]:
            continue
        if there > 0.0 and abs(there - here) > off:
            continue
        step = min(max(there - here, -limit), limit)
        depth[j, i] = here + step if there > 0.0 else here
        front[grown, 0], front[grown, 1] = j, i
        grown += 1
    return grown
