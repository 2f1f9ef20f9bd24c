"""Where a cloth passes through itself."""

from __future__ import annotations

import numpy as np

from clothrf_core.types import ClothMesh, Float


def crossings(x: Float, mesh: ClothMesh) -> int:
    """Pairs of an edge and a triangle, without a common vertex, that pierce each other."""
    t = mesh.triangles
    sides = np.concatenate([t[:, [0, 1]], t[:, [1, 2]], t[:, [2, 0]]])
    edges = np.unique(np.sort(sides, axis=1), axis=0)
    a, b, c = (x[t[:, k]] for k in range(3))
    low, high = np.minimum(np.minimum(a, b), c), np.maximum(np.maximum(a, b), c)
    return sum(_pierced(x, t, low, high, int(i), int(j)) for i, j in edges)


def _pierced(x: Float, t: np.ndarray, low: Float, high: Float, i: int, j: int) -> int:
    p, q = x[i], x[j]
    near = ((np.minimum(p, q) <= high) & (np.maximum(p, q) >= low)).all(axis=1)
    apart = ~((t == i) | (t == j)).any(axis=1)
    a, b, c = (x[t[near & apart, k]] for k in range(3))
    normal = np.cross(b - a, c - a)
    before, after = ((end - a) * normal for end in (p, q))
    before, after = before.sum(axis=1), after.sum(axis=1)
    through = before * after < 0
    a, b, c, normal = a[through], b[through], c[through], normal[through]
    share = (before / np.where(through, before - after, 1.0))[through]
    at = p + share[:, None] * (q - p)
    inside = [
        (np.cross(g - f, at - f) * normal).sum(axis=1) > 0 for f, g in ((a, b), (b, c), (c, a))
    ]
    return int(np.all(inside, axis=0).sum())
