"""Refined leaves: all leaves of all trees fitted jointly, by regularised least squares.

With H the (N, L) indicator of leaves, X the answers of the leaves and K_i the trees that answer
row i::

    min_X  sum_i || y_i - 1/K_i sum_(k answers i) X_(leaf k of i) ||^2 + theta ||X - X_mean||^2

(global refinement of random forests, Ren et al., CVPR 2015). A row is answered by the trees that
did not see it: the trees' splits fit their own rows too well, and answers fitted on those would
repeat the mistake. theta is the one with the least error on roll-outs left out.
"""

from __future__ import annotations

from dataclasses import replace

import numpy as np
from numpy.typing import NDArray
from scipy import sparse

from clothrf_core.types import Float
from clothrf_forest.leaves import Leaves

THETAS = (0.03, 0.1, 0.3, 1.0, 3.0, 10.0, 30.0)
ROUNDS = 15


def refined_leaves(
    leaves: Leaves,
    leaf: NDArray[np.int32],
    weights: NDArray[np.uint8],
    targets: Float,
    fold: NDArray[np.int64],
) -> tuple[Leaves, float]:
    """`leaves` with jointly fitted answers, and the theta that was chosen.

    Args:
        leaves: mean answers, what theta pulls to.
        leaf: (K, N) leaf of every row.
        weights: (K, N) how often each tree saw it.
        targets: (N, D) float64.
        fold: (N,) folds of whole roll-outs; fold 0 chooses theta.
    """
    indicator, answered = answers(leaf, weights == 0, len(leaves.values))
    y = targets[answered]
    mean = leaves.values.astype(np.float64)
    choosing = fold[answered] == 0
    train, test = indicator[~choosing], indicator[choosing]
    if test.shape[0] == 0 or train.shape[0] == 0:
        return leaves, np.inf
    start = y - indicator @ mean
    best, theta = float((start[choosing] ** 2).sum()), np.inf
    for candidate in reversed(THETAS):
        change = solved(train, start[~choosing], candidate)
        error = float(((start[choosing] - test @ change) ** 2).sum())
        if error > best:
            break
        best, theta = error, candidate
    if not np.isfinite(theta):
        return leaves, np.inf
    values = mean + solved(indicator, start, theta)
    return replace(leaves, values=values.astype(np.float32)), theta


def answers(
    leaf: NDArray[np.int32], asked: NDArray[np.bool_], num_leaves: int
) -> tuple[sparse.csr_array, NDArray[np.int64]]:
    """(M, L) matrix of 1 / K_i at the leaves of the trees asked, for rows with any; those rows."""
    count = asked.sum(0)
    rows = np.flatnonzero(count > 0)
    asked = asked[:, rows].T
    columns = leaf[:, rows].T[asked]
    share = np.repeat(1.0 / count[rows], count[rows])
    start = np.concatenate([[0], np.cumsum(count[rows])])
    return sparse.csr_array((share, columns, start), shape=(len(rows), num_leaves)), rows


def solved(indicator: sparse.csr_array, rest: Float, theta: float) -> Float:
    """(L, D) change X of least ``|rest - H X|^2 + theta |X|^2``, by conjugate gradients.

    All columns advance together; theta is in units of the mean diagonal of ``H'H``.
    """
    transposed = indicator.T.tocsr()
    diagonal = np.asarray(indicator.multiply(indicator).sum(0)).ravel()
    theta = theta * float(diagonal.sum()) / max(int((diagonal > 0).sum()), 1)
    inverse = 1.0 / (diagonal + theta)[:, None]
    x = np.zeros((indicator.shape[1], rest.shape[1]))
    r = transposed @ rest
    z = inverse * r
    p = z.copy()
    rz = (r * z).sum(0)
    for _ in range(ROUNDS):
        q = transposed @ (indicator @ p) + theta * p
        step = rz / np.maximum((p * q).sum(0), 1e-300)
        x += step * p
        r -= step * q
        z = inverse * r
        new = (r * z).sum(0)
        p = z + (new / np.maximum(rz, 1e-300)) * p
        rz = new
    return x
