"""Plain numpy forms of the kernels: slow, whole-picture, and what the kernels must equal."""

from __future__ import annotations

import numpy as np
from clothrf_randomize.disparity import BEYOND_DOTS2, DOT_RANGE, DOT_SHARE, DOT_TOLERANCE
from clothrf_randomize.edges import FAR2, REACH
from clothrf_randomize.pool import ACROSS, DOWN, DROP, NOISE
from clothrf_randomize.smooth import field

F = np.float32


def edge_distance2(depth, window, jump):
    top, bottom, left, right = window
    z = np.nan_to_num(depth[top:bottom, left:right])
    edge = np.zeros(z.shape, bool)
    down, across = np.abs(np.diff(z, axis=0)) > F(jump), np.abs(np.diff(z, axis=1)) > F(jump)
    edge[1:] |= down
    edge[:-1] |= down
    edge[:, 1:] |= across
    edge[:, :-1] |= across
    out = np.full(z.shape, float(FAR2))
    v, u = np.mgrid[: z.shape[0], : z.shape[1]]
    for y, x in zip(*np.nonzero(edge), strict=True):
        dy, dx = abs(v - y), abs(u - x)
        near = (dy <= REACH) & (dx <= REACH)
        out[near] = np.minimum(out, dy**2 + dx**2)[near]
    return out.astype(np.float32)


def stretch(values, starts, which, shape):
    return np.stack([values[s[which] : s[which] + shape[1]] for s in starts])


def edge_drop(near2, table):
    return np.select([near2 < n for n in (1, 4, 16, 64, 256)], table[:5], default=table[5])


def axial(depth, window, near2, lens, sensor, s, *, drop, pool, starts, nodes, grid, jump):
    shape = depth.shape
    whole = np.full(shape, FAR2, np.float32)
    top, bottom, left, right = window
    whole[top:bottom, left:right] = near2
    v, u = np.mgrid[: shape[0], : shape[1]]
    band = (whole <= F((3 * s.jitter) ** 2)) & (s.jitter > 0)
    dv = np.floor(F(s.jitter) * stretch(pool.normal, starts, DOWN, shape) + F(0.5)).astype(int)
    du = np.floor(F(s.jitter) * stretch(pool.normal, starts, ACROSS, shape) + F(0.5)).astype(int)
    v = np.where(band, np.clip(v + dv, 0, shape[0] - 1), v)
    u = np.where(band, np.clip(u + du, 0, shape[1] - 1), u)
    z = depth[v, u]
    cos2 = slant(depth, lens, jump, sensor.about_y)[v, u]
    lost, steep = np.zeros(shape, np.float32), np.zeros(shape, np.float32)
    if s.incidence > 0:
        n = (np.nan_to_num(cos2) * F(sensor.g.size - 1) + F(0.5)).astype(int)
        steep = F(s.incidence) * sensor.g[n]
        lost = np.minimum(F(s.incidence) * sensor.drop[n], F(1))
    keep = (F(1) - edge_drop(whole, drop)) * (F(1) - lost)
    sigma = sensor.a[0] + z * (sensor.a[1] + z * sensor.a[2])
    b0, b1, b2 = sensor.b
    sigma += steep * (b0 * sigma + F(1) / np.sqrt(z) * (b1 + b2 * z * z))
    noise = F(s.axial) * stretch(pool.normal, starts, NOISE, shape)
    noise = noise + F(s.smooth) * field(nodes, *grid)
    out = z + sigma * noise
    if s.unit > 0:
        out = np.floor(out * (F(1) / F(s.unit)) + F(0.5)) * F(s.unit)
    out = out * F(1 + s.scale) + F(s.bias)
    seen = (stretch(pool.uniform, starts, DROP, shape) < keep) & (out > 0)
    inside = np.zeros(shape, bool)
    inside[top:bottom, left:right] = True
    return np.where(seen & inside, out, np.nan).astype(np.float32)


def slant(depth, lens, jump, about_y):
    def slope(axis):
        ahead = np.full(depth.shape, np.nan, np.float32)
        behind = ahead.copy()
        steps = np.diff(depth, axis=axis)
        steps[np.abs(steps) > F(jump)] = np.nan
        if axis == 0:
            ahead[:-1], behind[1:] = steps, steps
        else:
            ahead[:, :-1], behind[:, 1:] = steps, steps
        both = np.stack([ahead, behind])
        count = np.isfinite(both).sum(axis=0)
        return np.nansum(both, axis=0) / np.maximum(count, 1).astype(np.float32)

    v, u = np.mgrid[: depth.shape[0], : depth.shape[1]]
    rx = ((u - lens.cx) / lens.fx).astype(np.float32)
    ry = ((v - lens.cy) / lens.fy).astype(np.float32)
    p = slope(1) * F(lens.fx) / depth
    q = slope(0) * F(lens.fy) / depth
    if about_y:
        q, ry = np.zeros_like(q), np.zeros_like(ry)
    m = 1 + rx * p + ry * q
    return 1 / ((p * p + q * q + m * m) * (1 + rx * rx + ry * ry))


def disparity(depth, window, near2, focal, sensor, s, *, drop, dots, pool, starts, nodes, grid):
    shape = depth.shape
    fb = F(sensor.focal_baseline or focal * sensor.baseline)
    top, bottom, left, right = window
    d = fb / sampled(depth, s.jitter, pool, starts)
    d = d[top:bottom, left:right].astype(np.float32)
    kept = d.copy()
    for r in range(d.shape[0]):
        lowest = np.inf
        for c in range(d.shape[1] - 1, -1, -1):
            place = left + c - d[r, c]
            if sensor.shadow and s.noise > 0 and np.isfinite(place):
                if place >= lowest or place < 0:
                    kept[r, c] = np.nan
                else:
                    lowest = place
            if (
                sensor.window
                and s.noise > 0
                and not matches(d, r, c, near2[r, c], dots, fb / F(DOT_RANGE))
            ):
                kept[r, c] = np.nan
    white = stretch(pool.normal, starts, NOISE, shape)
    noise = field(nodes, *grid) if sensor.cell_px else white
    noise = noise[top:bottom, left:right]
    moved = kept + F(s.noise * sensor.sigma_px) * noise
    step = s.noise * sensor.step_px
    if step > 0:
        moved = np.floor(moved * (F(1) / F(step)) + F(0.5)) * F(step)
    z = fb / np.where(moved > 0, moved, np.nan) * F(1 + s.scale) + F(s.bias)
    chance = stretch(pool.uniform, starts, DROP, shape)[top:bottom, left:right]
    seen = (chance < F(1) - edge_drop(near2, drop)) & (z > 0)
    out = np.full(shape, np.nan, np.float32)
    out[top:bottom, left:right] = np.where(seen, z, np.nan)
    return out


def sampled(depth, jitter, pool, starts):
    shape = depth.shape
    if jitter <= 0:
        return depth
    v, u = np.mgrid[: shape[0], : shape[1]].astype(float)
    v = np.clip(v + jitter * stretch(pool.normal, starts, DOWN, shape), 0, shape[0] - 1)
    u = np.clip(u + jitter * stretch(pool.normal, starts, ACROSS, shape), 0, shape[1] - 1)
    i, j = np.minimum(v.astype(int), shape[0] - 2), np.minimum(u.astype(int), shape[1] - 2)
    s, t = v - i, u - j
    z = (1 - s) * ((1 - t) * depth[i, j] + t * depth[i, j + 1])
    z += s * ((1 - t) * depth[i + 1, j] + t * depth[i + 1, j + 1])
    near = depth[(v + 0.5).astype(int), (u + 0.5).astype(int)]
    return np.where(np.isnan(z), near, z)


def matches(d, r, c, near2, dots, usual):
    h, w = d.shape
    if np.isnan(d[r, c]):
        return False
    if near2 >= BEYOND_DOTS2 and 2 <= r < h - 2 and 2 <= c < w - 2:
        across, down = d[r, c + 2] - d[r, c - 2], d[r + 2, c] - d[r - 2, c]
        tolerance = DOT_TOLERANCE * max(1.0, d[r, c] / usual)
        if (across**2 + down**2) / 16 < (0.5 * tolerance) ** 2:
            return True
    i, j = r + dots[:, 0].astype(int), c + dots[:, 1].astype(int)
    inside = (i >= 0) & (i < h) & (j >= 0) & (j < w)
    values = np.where(inside, d[np.clip(i, 0, h - 1), np.clip(j, 0, w - 1)], np.nan)
    if np.isfinite(values).sum() < DOT_SHARE * len(dots):
        return False
    mean = np.nanmean(values.astype(float))
    agree = np.abs(values - mean) * dots[:, 2] < DOT_TOLERANCE * max(1.0, mean / usual)
    return agree.sum() >= DOT_SHARE * len(dots)
