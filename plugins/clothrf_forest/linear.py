"""Linear leaves: a leaf answers its mean and how the answer changes along a few directions.

The directions are the projections that the splits may ask for too (`projections.py`). Each leaf is
a ridge regression on its own sample rows, shrunk towards the mean::

    y = mean_y + (p - mean_p) S,   S = (C_pp + penalty I)^-1 C_py

with covariances C of the leaf's rows (model trees: Quinlan 1992; local linear forests: Friedberg
et al. 2020).
"""

from __future__ import annotations

from dataclasses import replace

import numpy as np
from numpy.typing import NDArray

from clothrf_core.types import Float, Float32
from clothrf_forest.leaves import Leaves


def linear_leaves(
    leaves: Leaves,
    leaf: NDArray[np.int32],
    weights: NDArray[np.uint8],
    targets: Float,
    asked: Float32,
    penalty: float,
) -> Leaves:
    """`leaves` with slopes along the (N, h) projections `asked`, which have variance about 1.

    Args:
        leaves: mean answers.
        leaf: (K, N) leaf of every row.
        weights: (K, N) how often each tree saw it.
        targets: (N, D) float64.
        asked: (N, h) float32 projections of the rows.
        penalty: of the ridge, in units of the projections' mean variance.
    """
    h, d = asked.shape[1], targets.shape[1]
    num = len(leaves.values)
    p = asked.astype(np.float64)
    penalty = max(penalty * float(p.var(0).mean()), 1e-9)
    count = np.zeros(num)
    sums = np.zeros((num, h))
    square = np.zeros((num, h, h))
    cross = np.zeros((num, h, d))
    for k in range(len(leaf)):
        held = np.flatnonzero(weights[k])
        order = held[np.argsort(leaf[k, held], kind="stable")]
        label = leaf[k, order]
        start = np.flatnonzero(np.concatenate([[True], label[1:] != label[:-1]]))
        mine = label[start]
        w = weights[k, order].astype(float)[:, None]
        x, y = p[order], targets[order]
        count[mine] = np.add.reduceat(w, start)[:, 0]
        sums[mine] = np.add.reduceat(w * x, start)
        for i in range(h):
            square[mine, i] = np.add.reduceat(w * x[:, i : i + 1] * x, start)
            cross[mine, i] = np.add.reduceat(w * x[:, i : i + 1] * y, start)
    n = np.maximum(count, 1.0)[:, None]
    mean = sums / n
    answer = leaves.values.astype(np.float64)
    cov = square / n[:, :, None] - mean[:, :, None] * mean[:, None, :]
    cov += penalty * np.eye(h)
    slopes = np.linalg.solve(cov, cross / n[:, :, None] - mean[:, :, None] * answer[:, None, :])
    values = answer - (mean[:, :, None] * slopes).sum(1)
    return replace(leaves, values=values.astype(np.float32), slopes=slopes.astype(np.float32))
