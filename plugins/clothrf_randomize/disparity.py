"""The kernels of sensors whose errors are disparities: two cameras, or a camera and a pattern."""

from __future__ import annotations

from typing import NamedTuple

import numpy as np
from numba import njit
from numpy.typing import NDArray

from clothrf_core.types import Float, Float32
from clothrf_randomize.edges import Window
from clothrf_randomize.families import DisparitySensor
from clothrf_randomize.pool import ACROSS, DOWN, DROP, NOISE, Pool
from clothrf_randomize.smooth import Weights

# A pixel is matched if this share of the dots of its window agrees with their mean disparity
# within DOT_TOLERANCE / distance pixels (Bohg et al. 2014). That was set for rooms: nearer than
# DOT_RANGE metres the tolerance grows as 1 / z, as the disparities of a given slope do, or every
# surface on a table would be lost.
DOT_SHARE = 1.0 / 1.2
DOT_TOLERANCE = 0.1
DOT_RANGE = 1.5
# Squared distance from which no dot of the window reaches an edge, pixels^2.
BEYOND_DOTS2 = 36.0


class DisparityStrengths(NamedTuple):
    """What one frame is disturbed with; all 0 = identity.

    Attributes:
        jitter: pixels.
        noise: factor of the disparity noise and of the step.
        bias: m.
        scale: share.
    """

    jitter: float
    noise: float
    bias: float
    scale: float


def dot_pattern() -> Float:
    """(D, 3) float64 rows (dy, dx, 1 / distance): the dots of a 9 x 9 window, a fixed pattern.

    About a third of the pixels, at least one in each 3 x 3 block, like the published pattern.
    """
    rng = np.random.default_rng(20140601)
    dots = np.zeros((9, 9), bool)
    for block in np.ndindex(3, 3):
        chosen = rng.choice(9, size=3, replace=False)
        dots[3 * block[0] + chosen // 3, 3 * block[1] + chosen % 3] = True
    dots[4, 4] = False
    dy, dx = np.nonzero(dots)
    offset = np.stack([dy - 4.0, dx - 4.0], axis=1)
    return np.column_stack([offset, 1.0 / np.hypot(offset[:, 0], offset[:, 1])])


def disparity_noise(
    depth: Float32,
    window: Window,
    distance2: Float32,
    focal: float,
    sensor: DisparitySensor,
    strengths: DisparityStrengths,
    *,
    edge_drop: Float32,
    dots: Float,
    pool: Pool,
    starts: NDArray[np.int64],
    nodes: Float32,
    grid: tuple[Weights, Weights],
) -> Float32:
    """(H, W) float32 disturbed copy of `depth`.

    Args:
        depth: (H, W) float32, m, NaN = nothing measured.
        window: holds every measured pixel and the margin into which edges may wobble.
        distance2: (h, w) of the window, see `edge_distance2`.
        focal: fx of the camera that is told, pixels.
        sensor: numbers of the family.
        strengths: of this frame.
        edge_drop: (6,) float32, see `families.EDGE_DROP`.
        dots: `dot_pattern`.
        pool: random numbers.
        starts: (H, 4) where each row reads the pool.
        nodes: (R, C) standard normal numbers of the shared noise.
        grid: weights along rows and columns for `nodes`.
    """
    fb = np.float32(sensor.focal_baseline or focal * sensor.baseline)
    rows, columns = grid
    matched = _sampled(depth, *window, fb, pool.normal, starts, strengths.jitter)
    out = np.full(depth.shape, np.nan, np.float32)
    active = strengths.noise > 0.0
    numbers = (
        strengths.noise * sensor.sigma_px, strengths.noise * sensor.step_px,
        strengths.bias, strengths.scale,
    )  # fmt: skip
    _disparity(
        matched, out, *window, distance2, fb, edge_drop, pool.normal, pool.uniform, starts, dots,
        nodes, *rows, *columns, sensor.cell_px > 0, sensor.window and active,
        sensor.shadow and active, *(np.float32(n) for n in numbers),
    )  # fmt: skip
    return out


@njit(cache=True, nogil=True, error_model="numpy")
def _sampled(depth, top, bottom, left, right, fb, normal, starts, jitter):  # type: ignore[no-untyped-def]
    """(h, w) float32 disparities of the window, each read at a jittered place, bilinearly."""
    height, width = depth.shape
    out = np.full((bottom - top, right - left), np.nan, np.float32)
    for y in range(top, bottom):
        if jitter <= 0.0:
            source, target = depth[y, left:right], out[y - top]
            for c in range(target.size):
                target[c] = fb / source[c]
            continue
        down, across = normal[starts[y, DOWN] :], normal[starts[y, ACROSS] :]
        for x in range(left, right):
            v = min(max(y + jitter * down[x], 0.0), height - 1.0)
            u = min(max(x + jitter * across[x], 0.0), width - 1.0)
            i, j = min(int(v), height - 2), min(int(u), width - 2)
            s, t = v - i, u - j
            z = (1.0 - s) * ((1.0 - t) * depth[i, j] + t * depth[i, j + 1]) + s * (
                (1.0 - t) * depth[i + 1, j] + t * depth[i + 1, j + 1]
            )
            if z != z:  # at a border: the nearest pixel, measured or not
                z = np.float64(depth[int(v + 0.5), int(u + 0.5)])
            out[y - top, x - left] = fb / z
    return out


@njit(cache=True, nogil=True, error_model="numpy")
def _disparity(  # type: ignore[no-untyped-def]
    matched, out, top, bottom, left, right, distance2, fb, edge_drop, normal, uniform, starts,
    dots, nodes, row_n, row_h, row_a, col_n, col_h, col_a, shared, windowed, shadowed, sigma, step,
    bias, scale,
):  # fmt: skip
    """Row by row: drop what cannot be matched, then disturb the rest."""
    h, w = matched.shape
    d, common = np.empty(w, np.float32), np.empty(w, np.float32)
    for r in range(h):
        y = top + r
        d[:] = matched[r]
        if shadowed:
            _drop_shadow(d, left)
        if windowed:
            _drop_unmatched(d, matched, r, distance2[r], dots, fb / np.float32(DOT_RANGE))
        noise = normal[starts[y, NOISE] + left :]
        if shared:
            above, below = nodes[row_n[y]], nodes[row_n[y] + 1]
            here, after = row_h[y], row_a[y]
            for c in range(w):
                j = col_n[left + c]
                first = here * above[j] + after * below[j]
                second = here * above[j + 1] + after * below[j + 1]
                common[c] = first * col_h[left + c] + second * col_a[left + c]
            noise = common
        _disturb(
            out[y, left:right], d, distance2[r], noise, uniform[starts[y, DROP] + left :], fb,
            edge_drop, sigma, step, bias, scale,
        )  # fmt: skip


@njit(cache=True, nogil=True, error_model="numpy")
def _drop_shadow(d, left):  # type: ignore[no-untyped-def]
    """Drop pixels of a row that the second camera, to the right, does not see.

    A pixel is hidden if one further right appears at or before its place there, or if its place
    lies outside the second picture.
    """
    lowest = np.inf
    for c in range(d.size - 1, -1, -1):
        if d[c] == d[c]:
            place = left + c - d[c]
            if place >= lowest or place < 0.0:
                d[c] = np.nan
            else:
                lowest = place


@njit(cache=True, nogil=True, error_model="numpy")
def _drop_unmatched(d, matched, r, near2, dots, usual):  # type: ignore[no-untyped-def]
    """Drop pixels of row `r` whose window of dots does not agree on one disparity.

    Where the window lies on one surface of little slope it always agrees: not looked at.
    """
    h, w = matched.shape
    for c in range(w):
        if d[c] != d[c]:
            continue
        if near2[c] >= BEYOND_DOTS2 and 2 <= r < h - 2 and 2 <= c < w - 2:
            across = 0.25 * (matched[r, c + 2] - matched[r, c - 2])
            down = 0.25 * (matched[r + 2, c] - matched[r - 2, c])
            tolerance = DOT_TOLERANCE * max(1.0, d[c] / usual)
            if across * across + down * down < (0.5 * tolerance) ** 2:
                continue
        if not _matches(matched, r, c, dots, usual):
            d[c] = np.nan


@njit(cache=True, nogil=True, error_model="numpy")
def _matches(matched, r, c, dots, usual):  # type: ignore[no-untyped-def]
    """Whether the dots of the window about (r, c) agree; pixels outside the window do not."""
    h, w = matched.shape
    count = dots.shape[0]
    total, valid = 0.0, 0
    for k in range(count):
        i, j = r + int(dots[k, 0]), c + int(dots[k, 1])
        if 0 <= i < h and 0 <= j < w:
            d = matched[i, j]
            if d == d:
                total += d
                valid += 1
    if valid < DOT_SHARE * count:
        return False
    mean = total / valid
    tolerance = DOT_TOLERANCE * max(1.0, mean / usual)
    agreeing = 0
    for k in range(count):
        i, j = r + int(dots[k, 0]), c + int(dots[k, 1])
        if 0 <= i < h and 0 <= j < w and abs(matched[i, j] - mean) * dots[k, 2] < tolerance:
            agreeing += 1
    return agreeing >= DOT_SHARE * count


@njit(cache=True, nogil=True, error_model="numpy")
def _disturb(  # type: ignore[no-untyped-def]
    out, d, near2, noise, chance, fb, edge_drop, sigma, step, bias, scale
):  # fmt: skip
    """Noise, rounding, drop-outs, bias and scale of a row."""
    zero, half, one, nothing = np.float32(0), np.float32(0.5), np.float32(1), np.float32(np.nan)
    p1, p2, p4, p8, p16, beyond = edge_drop
    per_step = one / step if step > zero else zero
    gain = one + scale
    for c in range(out.size):
        d2 = near2[c]
        p = p16 if d2 < np.float32(256.0) else beyond
        p = p8 if d2 < np.float32(64.0) else p
        p = p4 if d2 < np.float32(16.0) else p
        p = p2 if d2 < np.float32(4.0) else p
        p = p1 if d2 < one else p
        moved = d[c] + sigma * noise[c]
        if step > zero:
            moved = np.floor(moved * per_step + half) * step
        moved = moved if moved > zero else nothing
        z = fb / moved * gain + bias
        z = z if z > zero else nothing
        out[c] = z if chance[c] < one - p else nothing
