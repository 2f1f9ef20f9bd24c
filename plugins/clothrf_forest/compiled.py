"""The compiled form of `answer.answer_in_numpy`: one row in a few tens of microseconds."""

from __future__ import annotations

from typing import Any

import numpy as np
from numba import njit

from clothrf_forest.curves import REACH
from clothrf_forest.ridge import LIMIT


@njit(cache=True, nogil=True)
def interpolated(x: Any, knots: Any, values: Any) -> Any:
    """Linear interpolation; constant beyond the ends, as ``np.interp``."""
    n = knots.size
    if x <= knots[0]:
        return values[0]
    for i in range(1, n):
        if x <= knots[i]:
            # Equal knots never get here: x would have been at most the first of them.
            part = (x - knots[i - 1]) / (knots[i] - knots[i - 1])
            return values[i - 1] + part * (values[i] - values[i - 1])
    return values[n - 1]


@njit(cache=True, nogil=True)
def clipped(x: Any, limit: Any) -> Any:
    """The value within +- limit; NaN stays NaN."""
    if x > limit:
        return limit
    return -limit if x < -limit else x


@njit(cache=True, nogil=True)
def answer(values: Any, anchor: Any, of: Any, out: Any) -> None:
    """See `answer.answer_in_numpy`."""
    d = of.intercept.size
    h = of.offset.size
    k = of.mean.size
    f = of.centre.size
    x = np.empty(f + h, np.float32)
    x[: values.size] = values
    for i in range(values.size, f):
        x[i] = anchor[i - values.size]
    q = of.curve_offset.size
    width = d + h + q + k
    along = np.zeros(width)
    length = 0.0
    for i in range(f):
        z = clipped(np.float64((x[i] - of.centre[i]) * of.scale[i]), LIMIT)
        length += z * z
        for j in range(width):
            along[j] += z * of.matrix[i, j]
    for j in range(h):
        x[f + j] = along[d + j] + of.offset[j]
    novelty = 0.0
    for j in range(k):
        a = along[d + h + q + j]
        length -= a * a
        novelty += (a - of.mean[j]) ** 2 * of.precision[j]
    novelty = (novelty + max(length, 0.0) * of.rest) / f

    for i in range(q):
        u = d + h + i
        along[u] = clipped(along[u] + of.curve_offset[i], REACH)
    p = 0
    for i in range(q):
        for j in range(i, q):
            product = along[d + h + i] * along[d + h + j]
            for m in range(d):
                along[m] += product * of.bend[p, m]
            p += 1

    num_trees = of.roots.size
    nodes = of.nodes
    out[:] = 0.0
    square = 0.0
    within = 0.0
    used_to = 0.0
    # All trees go down together, so that their reads from memory overlap (a tenth faster).
    at = np.empty(num_trees, np.int32)
    at[:] = of.roots
    left = num_trees
    while left > 0:
        still = 0
        for t in range(num_trees):
            node = at[t]
            first = nodes[node].first
            if first >= 0:
                value = x[first]
                second = nodes[node].second
                if second >= 0:
                    value -= x[second]
                at[t] = nodes[node].child + (0 if value <= nodes[node].threshold else 1)
                still += 1
        left = still
    for t in range(num_trees):
        leaf = nodes[at[t]].child
        within += of.variance[leaf]
        used_to += of.usual[leaf]
        for j in range(d):
            v = np.float64(of.values[leaf, j])
            for i in range(of.slopes.shape[1]):
                v += np.float64(x[f + i]) * of.slopes[leaf, i, j]
            out[j] += v
            square += v * v
    score = novelty
    novelty = score / np.exp(used_to / num_trees)
    between = square / (num_trees * d)
    sound = np.isfinite(novelty)
    for j in range(d):
        out[j] /= num_trees
        between -= out[j] * out[j] / d
        out[j] += along[j] + of.intercept[j]
        if of.anchored:
            out[j] += anchor[j % 3]
        sound = sound and np.isfinite(out[j])
    spread = np.sqrt(max(between, 0.0) + within / num_trees)
    familiar = 1.0
    if novelty > of.limits[0]:
        familiar = max(0.0, (of.limits[1] - novelty) / (of.limits[1] - of.limits[0]))
    out[d] = spread
    out[d + 1] = novelty
    out[d + 2] = 0.0
    out[d + 3] = np.inf
    if sound:
        knots = of.calibration[0]
        doubt = spread * score * novelty**2
        out[d + 2] = familiar * interpolated(doubt, knots, of.calibration[1])
        out[d + 3] = interpolated(doubt, knots, of.calibration[2])
