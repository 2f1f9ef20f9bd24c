"""From a feature row to one leaf of every tree, in numpy: always present, a few rows or many.

`act.py` holds the compiled form for one row, which the control loop uses.
"""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from clothrf_core.types import Float32
from clothrf_forest.trees import Trees


def leaves_of(trees: Trees, values: Float32) -> NDArray[np.int64]:
    """(n, K) leaf numbers of (n, F) float32 rows; all rows and trees descend level by level."""
    n = len(values)
    node = np.broadcast_to(trees.roots.astype(np.int64), (n, len(trees.roots))).copy()
    row = np.arange(n)[:, None]
    first, second = trees.nodes["first"], trees.nodes["second"]
    threshold, child = trees.nodes["threshold"], trees.nodes["child"]
    while True:
        f = first[node]
        inner = f >= 0
        if not inner.any():
            break
        s = second[node]
        x = values[row, np.maximum(f, 0)]
        if (s >= 0).any():
            x = np.where(s >= 0, x - values[row, np.maximum(s, 0)], x)
        with np.errstate(invalid="ignore"):
            right = ~(x <= threshold[node])
        node = np.where(inner, child[node] + right, node)
    leaves: NDArray[np.int64] = child[node].astype(np.int64)
    return leaves
