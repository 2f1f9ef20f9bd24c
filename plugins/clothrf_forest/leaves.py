"""What leaves answer: the mean action of their rows (the paper), and what is known out of bag.

A row is out of bag for a tree whose sample does not hold it (nor, with ``bootstrap = "groups"``,
any frame of its roll-out): the mean over such trees is an honest prediction of the row.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from clothrf_core.types import Float, Float32
from clothrf_forest.trees import Tree


@dataclass(frozen=True, slots=True)
class Leaves:
    """Answers of all leaves; those of tree k are numbered before those of k + 1.

    Attributes:
        values: (L, D) float32; where there are slopes, the answer at projections of 0.
        variance: (L, T) float32 spread of the leaf's rows, mean over a task's coordinates, m^2.
        slopes: (L, h, D) float32 change of the answer along each projection; h = 0: none.
    """

    values: Float32
    variance: Float32
    slopes: Float32

    def answers(self, leaf: NDArray[np.int32], asked: Float32) -> Float:
        """(n, D) answers of (n,) leaves to rows with (n, h) projections."""
        found: Float = self.values[leaf].astype(np.float64)
        for i in range(self.slopes.shape[1]):  # none for mean leaves
            found += asked[:, i : i + 1].astype(np.float64) * self.slopes[leaf, i]
        return found


def leaf_numbers(trees: list[Tree]) -> NDArray[np.int32]:
    """(K, N) leaf of every training row in every tree, numbered over the forest."""
    offset = np.cumsum([0] + [t.num_leaves for t in trees])
    return np.stack([t.leaf + np.int32(o) for t, o in zip(trees, offset, strict=False)])


def mean_leaves(
    leaf: NDArray[np.int32],
    num_leaves: int,
    weights: NDArray[np.uint8],
    targets: Float,
    tasks: int,
) -> Leaves:
    """Mean of (N, D) targets of each leaf's sample rows, and their variance per task."""
    d = targets.shape[1]
    total = np.zeros((num_leaves, d))
    square = np.zeros((num_leaves, d))
    count = np.zeros(num_leaves)
    for k in range(len(leaf)):
        held = np.flatnonzero(weights[k])
        w = weights[k, held].astype(float)
        index = leaf[k, held]
        low, high = int(index.min()), int(index.max()) + 1
        index = index - low
        count[low:high] += np.bincount(index, w, high - low)
        for j in range(d):
            y = targets[held, j]
            total[low:high, j] += np.bincount(index, w * y, high - low)
            square[low:high, j] += np.bincount(index, w * y * y, high - low)
    mean = total / np.maximum(count, 1.0)[:, None]
    variance = np.maximum(square / np.maximum(count, 1.0)[:, None] - mean**2, 0.0)
    per_task = variance.reshape(num_leaves, tasks, d // tasks).mean(2)
    flat = np.zeros((num_leaves, 0, d), np.float32)
    return Leaves(mean.astype(np.float32), per_task.astype(np.float32), flat)


@dataclass(frozen=True, slots=True)
class OutOfBag:
    """Predictions of rows by trees that did not see them.

    Attributes:
        rows: (M,) rows that enough trees left out.
        prediction: (M, D) mean over those trees.
        spread: (M, T) standard deviation expected of the answer: what the leaves' rows and the
            trees among themselves disagree, root mean square over a task's coordinates, m.
    """

    rows: NDArray[np.int64]
    prediction: Float
    spread: Float


def out_of_bag(
    leaf: NDArray[np.int32],
    weights: NDArray[np.uint8],
    leaves: Leaves,
    tasks: int,
    asked: Float32 | None = None,
) -> OutOfBag:
    """`OutOfBag` of all rows that at least 3 trees (or all, if fewer) left out."""
    num_trees, n = leaf.shape
    asked = np.zeros((n, 0), np.float32) if asked is None else asked
    d = leaves.values.shape[1]
    count = np.zeros(n)
    total = np.zeros((n, d))
    square = np.zeros((n, tasks))
    within = np.zeros((n, tasks))
    for k in range(num_trees):
        out = np.flatnonzero(weights[k] == 0)
        value = leaves.answers(leaf[k, out], asked[out])
        count[out] += 1
        total[out] += value
        square[out] += (value**2).reshape(len(out), tasks, d // tasks).mean(2)
        within[out] += leaves.variance[leaf[k, out]]
    rows = np.flatnonzero(count >= min(3, num_trees))
    c = count[rows, None]
    mean = total[rows] / c
    between = square[rows] / c - (mean**2).reshape(len(rows), tasks, d // tasks).mean(2)
    spread = np.sqrt(np.maximum(between, 0.0) + within[rows] / c)
    return OutOfBag(rows, mean, spread)
