"""The kernel of sensors whose errors are lengths: jitter, noise, drop-outs and rounding at once."""

from __future__ import annotations

from typing import NamedTuple

import numpy as np
from numba import njit
from numpy.typing import NDArray

from clothrf_core.types import Float32
from clothrf_randomize.edges import Window
from clothrf_randomize.families import AxialSensor
from clothrf_randomize.pool import ACROSS, DOWN, DROP, NOISE, Pool
from clothrf_randomize.smooth import Weights


class Lens(NamedTuple):
    """Intrinsics as four floats; the kernels need no more."""

    fx: float
    fy: float
    cx: float
    cy: float


class AxialStrengths(NamedTuple):
    """What one frame is disturbed with; all 0 = identity.

    Attributes:
        jitter: pixels.
        axial: factor of sigma for white noise.
        smooth: factor of sigma for low-frequency noise.
        incidence: factor of what slant adds.
        unit: m; 0 = not rounded.
        bias: m.
        scale: share.
    """

    jitter: float
    axial: float
    smooth: float
    incidence: float
    unit: float
    bias: float
    scale: float


def axial_noise(
    depth: Float32,
    window: Window,
    distance2: Float32,
    lens: Lens,
    sensor: AxialSensor,
    strengths: AxialStrengths,
    *,
    edge_drop: Float32,
    pool: Pool,
    starts: NDArray[np.int64],
    nodes: Float32,
    grid: tuple[Weights, Weights],
    jump: float,
) -> Float32:
    """(H, W) float32 disturbed copy of `depth`.

    Args:
        depth: (H, W) float32, m, NaN = nothing measured.
        window: holds every measured pixel and the margin into which edges may wobble.
        distance2: (h, w) of the window, see `edge_distance2`.
        lens: of the camera that is told.
        sensor: tables of the family.
        strengths: of this frame.
        edge_drop: (6,) float32, see `families.EDGE_DROP`.
        pool: random numbers.
        starts: (H, 4) where each row reads the pool.
        nodes: (R, C) standard normal numbers of the low-frequency noise.
        grid: weights along rows and columns for `nodes`.
        jump: neighbours that differ by more belong to other surfaces, m.
    """
    out = np.full(depth.shape, np.nan, np.float32)
    rows, columns = grid
    band2 = (3.0 * strengths.jitter) ** 2 if strengths.jitter > 0.0 else -1.0
    _axial(
        depth, out, *window, distance2, *lens, sensor.a, sensor.b, sensor.g, sensor.drop,
        sensor.about_y, edge_drop, pool.normal, pool.uniform, starts, nodes, *rows, *columns,
        np.float32(band2), np.float32(jump), *(np.float32(s) for s in strengths),
    )  # fmt: skip
    return out


@njit(cache=True, nogil=True, error_model="numpy")
def _axial(  # type: ignore[no-untyped-def]
    depth, out, top, bottom, left, right, distance2, fx, fy, cx, cy, a, b, g, drop,
    about_y, edge_drop, normal, uniform, starts, nodes, row_n, row_h, row_a, col_n, col_h, col_a,
    band2, jump, jitter, axial, smooth, incidence, unit, bias, scale,
):  # fmt: skip
    """Row by row in single precision; all but jitter and two table look-ups vectorises."""
    width = depth.shape[1]
    w = right - left
    rx = ((np.arange(width) - cx) / fx).astype(np.float32)
    z, cos2 = np.empty(w, np.float32), np.ones(w, np.float32)
    slant, lost = np.zeros(w, np.float32), np.zeros(w, np.float32)
    shared = np.empty(w, np.float32)
    ends = np.searchsorted(col_n, np.arange(nodes.shape[1] - 1), side="right")
    for y in range(top, bottom):
        near2 = distance2[y - top]
        ry = np.float32(0.0 if about_y else (y - cy) / fy)
        z[:] = depth[y, left:right]
        if incidence > 0.0:
            _slant(depth, y, left, rx, ry, fx, fy, about_y, cos2)
        _at_edges(
            depth, y, left, near2, band2, jitter, normal[starts[y, DOWN] + left :],
            normal[starts[y, ACROSS] + left :], rx, cy, fx, fy, about_y, incidence, jump, z, cos2,
        )  # fmt: skip
        if incidence > 0.0:
            _look_up(z, cos2, incidence, g, drop, slant, lost)
        _level(shared, left, smooth, nodes, row_n[y], row_h[y], row_a[y], ends, col_h, col_a)
        _disturb(
            out[y, left:right], z, near2, slant, lost, shared, normal[starts[y, NOISE] + left :],
            uniform[starts[y, DROP] + left :], a, b, edge_drop, axial, unit, bias, scale,
        )  # fmt: skip


@njit(cache=True, nogil=True, error_model="numpy")
def _slant(depth, y, left, rx, ry, fx, fy, about_y, cos2):  # type: ignore[no-untyped-def]
    """Write cos^2 of the angle between normal and ray along row `y`, right off the edges only."""
    height, width = depth.shape
    above, here, below = depth[max(y - 1, 0)], depth[y], depth[min(y + 1, height - 1)]
    one = np.float32(1.0)
    half_x, half_y = np.float32(0.5 * fx), np.float32(0.0 if about_y else 0.5 * fy)
    start, end = max(left, 1), min(left + cos2.size, width - 1)
    before, after = here[start - 1 : end - 1], here[start + 1 : end + 1]
    here, above, below = here[start:end], above[start:end], below[start:end]
    ray, result = rx[start:end], cos2[start - left : end - left]
    for x in range(end - start):
        per_z = one / here[x]
        p = (after[x] - before[x]) * half_x * per_z
        q = (below[x] - above[x]) * half_y * per_z
        # Normal (-p, -q, m), ray (rx, ry, 1): their product is 1.
        m = one + ray[x] * p + ry * q
        result[x] = one / ((p * p + q * q + m * m) * (one + ray[x] * ray[x] + ry * ry))


@njit(cache=True, nogil=True, error_model="numpy")
def _at_edges(  # type: ignore[no-untyped-def]
    depth, y, left, near2, band2, jitter, down, across, rx, cy, fx, fy, about_y, incidence, jump,
    z, cos2,
):  # fmt: skip
    """Redo `z` and `cos2` of a row near edges: wobbled, and with one-sided slopes."""
    height, width = depth.shape
    half = np.float32(0.5)
    border = y in (0, height - 1)
    for c in range(z.size):
        x = left + c
        at_edge = near2[c] <= 0.0 or border or x in (0, width - 1)
        if near2[c] > band2 and not at_edge:
            continue
        v, u = y, x
        if near2[c] <= band2:
            v = min(max(y + int(np.floor(jitter * down[c] + half)), 0), height - 1)
            u = min(max(x + int(np.floor(jitter * across[c] + half)), 0), width - 1)
        z[c] = depth[v, u]
        if incidence > 0.0 and z[c] == z[c]:
            cos2[c] = _slant_at_edge(depth, v, u, rx, cy, fx, fy, about_y, jump)


@njit(cache=True, nogil=True, error_model="numpy")
def _slant_at_edge(depth, v, u, rx, cy, fx, fy, about_y, jump):  # type: ignore[no-untyped-def]
    """cos^2 at one pixel, from those neighbours that lie on its surface."""
    one = np.float32(1.0)
    per_z = one / depth[v, u]
    p = _slope(depth, v, u, 0, 1, jump) * np.float32(fx) * per_z
    q = _slope(depth, v, u, 1, 0, jump) * np.float32(0.0 if about_y else fy) * per_z
    ry = np.float32(0.0 if about_y else (v - cy) / fy)
    m = one + rx[u] * p + ry * q
    return one / ((p * p + q * q + m * m) * (one + rx[u] * rx[u] + ry * ry))


@njit(cache=True, nogil=True, error_model="numpy")
def _slope(depth, v, u, dv, du, jump):  # type: ignore[no-untyped-def]
    """Change of depth a pixel along (dv, du), from the neighbours on the same surface."""
    height, width = depth.shape
    z = depth[v, u]
    total, count = np.float32(0.0), np.float32(0.0)
    if v + dv < height and u + du < width:
        step = depth[v + dv, u + du] - z
        if abs(step) <= jump:
            total += step
            count += np.float32(1.0)
    if v - dv >= 0 and u - du >= 0:
        step = z - depth[v - dv, u - du]
        if abs(step) <= jump:
            total += step
            count += np.float32(1.0)
    return total / count if count > 0 else np.float32(0.0)


@njit(cache=True, nogil=True, error_model="numpy")
def _look_up(z, cos2, incidence, g, drop, slant, lost):  # type: ignore[no-untyped-def]
    """What slant adds to sigma (times b) and the share of pixels it loses, along a row."""
    last, half, one = np.float32(g.size - 1), np.float32(0.5), np.float32(1.0)
    for c in range(z.size):
        if z[c] != z[c]:
            continue
        n = int(cos2[c] * last + half)
        slant[c] = incidence * g[n]
        p = incidence * drop[n]
        lost[c] = p if p < one else one


@njit(cache=True, nogil=True, error_model="numpy")
def _level(  # type: ignore[no-untyped-def]
    shared, left, smooth, nodes, node, here, after, ends, col_h, col_a
):  # fmt: skip
    """Low-frequency noise along a row, one stretch between two nodes after the other."""
    start, w = 0, shared.size
    for j in range(ends.size):
        end = min(max(ends[j] - left, 0), w)
        first = np.float32(smooth * (here * nodes[node, j] + after * nodes[node + 1, j]))
        second = np.float32(smooth * (here * nodes[node, j + 1] + after * nodes[node + 1, j + 1]))
        stretch, weight_h, weight_a = (
            shared[start:end],
            col_h[left + start :],
            col_a[left + start :],
        )
        for k in range(stretch.size):
            stretch[k] = first * weight_h[k] + second * weight_a[k]
        start = max(start, end)


@njit(cache=True, nogil=True, error_model="numpy")
def _disturb(  # type: ignore[no-untyped-def]
    out, z, near2, slant, lost, shared, noise, chance, a, b, edge_drop, axial, unit, bias, scale
):  # fmt: skip
    """Noise, drop-outs, rounding, bias and scale of a row."""
    zero, half, one, nothing = np.float32(0), np.float32(0.5), np.float32(1), np.float32(np.nan)
    a0, a1, a2 = a
    b0, b1, b2 = b
    p1, p2, p4, p8, p16, beyond = edge_drop
    per_unit = one / unit if unit > zero else zero
    gain = one + scale
    for c in range(out.size):
        d2, here = near2[c], z[c]
        p = p16 if d2 < np.float32(256.0) else beyond
        p = p8 if d2 < np.float32(64.0) else p
        p = p4 if d2 < np.float32(16.0) else p
        p = p2 if d2 < np.float32(4.0) else p
        p = p1 if d2 < one else p
        keep = (one - p) * (one - lost[c])
        sigma = a0 + here * (a1 + here * a2)
        root = one / np.sqrt(here)
        sigma += slant[c] * (b0 * sigma + root * (b1 + b2 * here * here))
        moved = here + sigma * (axial * noise[c] + shared[c])
        if unit > zero:
            moved = np.floor(moved * per_unit + half) * unit
        moved = moved * gain + bias
        # NaN fails the comparison too.
        moved = moved if moved > zero else nothing
        out[c] = moved if chance[c] < keep else nothing
