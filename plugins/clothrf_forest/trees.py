"""The forest as flat arrays, and how its trees are drawn and grown in threads.

A node is 16 bytes, so a step down a tree reads one cache line. The children of a node are
neighbours: going right is one further than going left.
"""

from __future__ import annotations

from collections.abc import Callable
from concurrent.futures import ThreadPoolExecutor
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from clothrf_core.types import Float, Float32
from clothrf_forest.binning import Columns

NODE = np.dtype(
    [("first", "<i4"), ("second", "<i4"), ("threshold", "<f4"), ("child", "<i4")], align=True
)

Weights = NDArray[np.uint8]


@dataclass(frozen=True, slots=True)
class Tree:
    """One tree on levels, as growing leaves it.

    Attributes:
        column: (M,) int32 column tested, -1 at a leaf.
        cut: (M,) uint8 rows with ``level <= cut`` go left.
        child: (M,) int32 left child (the right one follows it); at a leaf its number.
        gain: (M,) float64 impurity decrease of the split.
        leaf: (N,) int32 leaf of every training row, in the tree's sample or not.
        num_leaves: L.
    """

    column: NDArray[np.int32]
    cut: NDArray[np.uint8]
    child: NDArray[np.int32]
    gain: Float
    leaf: NDArray[np.int32]
    num_leaves: int


@dataclass(frozen=True, slots=True)
class Trees:
    """All trees in one array of nodes.

    Attributes:
        nodes: (M,) `NODE`: feature tested, feature subtracted from it or -1, threshold (values
            up to it go left), left child; at a leaf ``first = -1`` and child is the leaf's number.
        roots: (K,) int32 first node of each tree.
        num_leaves: leaves of all trees; those of tree k are numbered before those of k + 1.
    """

    nodes: NDArray[np.void]
    roots: NDArray[np.int32]
    num_leaves: int


@dataclass(frozen=True, slots=True)
class Growth:
    """What stops a tree; see `ForestConfig`."""

    max_depth: int
    min_gain: float
    node_local: bool
    max_features: int
    min_samples_leaf: int
    always: int = 0


@dataclass(frozen=True, slots=True)
class Problem:
    """What all trees of a forest are grown on.

    Attributes:
        codes: (C, N) uint8 levels.
        labels: (N,) int32 class of each row.
        num_labels: 0 = variance reduction of `targets` instead.
        targets: (N, D) float64 whose variance is reduced.
    """

    codes: NDArray[np.uint8]
    labels: NDArray[np.int32]
    num_labels: int
    targets: Float


Grower = Callable[[Problem, Weights, Growth, int], Tree]


def samples(
    kind: str, share: float, groups: NDArray[np.int64], seeds: NDArray[np.int64]
) -> NDArray[np.uint8]:
    """(K, N) how often each row is in each tree's sample; 0 = out of bag.

    Drawing whole roll-outs keeps the frames that look alike on one side, so that what is out of
    bag tells the error on a roll-out never seen. Fewer than 10 roll-outs are drawn by rows.
    """
    n = len(groups)
    distinct, member = np.unique(groups, return_inverse=True)
    if kind == "rows" or len(distinct) < 10:
        distinct, member = np.arange(n), np.arange(n)
    units = max(1, round(share * len(distinct)))
    weights = np.empty((len(seeds), n), np.uint8)
    for k, seed in enumerate(seeds):
        rng = np.random.default_rng(int(seed))
        if kind == "none":
            drawn = rng.permutation(len(distinct))[:units]
        else:
            drawn = rng.integers(len(distinct), size=units)
        counts = np.bincount(drawn, minlength=len(distinct))
        weights[k] = np.minimum(counts, 255)[member]
    return weights


def grow_all(
    problem: Problem,
    weights: NDArray[np.uint8],
    growth: Growth,
    seeds: NDArray[np.int64],
    grower: Grower,
    *,
    threads: int,
) -> list[Tree]:
    """K trees; the same whatever the number of threads."""

    def one(k: int) -> Tree:
        return grower(problem, weights[k], growth, int(seeds[k]))

    with ThreadPoolExecutor(max_workers=threads) as pool:
        return list(pool.map(one, range(len(seeds))))


def numba_grower(problem: Problem, weights: Weights, growth: Growth, seed: int) -> Tree:
    """A tree grown by the compiled kernel."""
    from clothrf_forest.growth import entropy_table, grow_tree

    table = entropy_table(int(weights.sum(dtype=np.int64)) if problem.num_labels else 0)
    return Tree(
        *grow_tree(
            problem.codes,
            problem.labels,
            problem.num_labels,
            problem.targets,
            weights,
            table,
            np.uint64(seed),
            growth.max_depth,
            growth.min_gain,
            growth.node_local,
            growth.max_features,
            growth.min_samples_leaf,
            growth.always,
        )
    )


def flattened(trees: list[Tree], columns: Columns, cuts: list[Float32]) -> Trees:
    """The trees with levels turned back into values and all nodes in one array."""
    roots = np.cumsum([0] + [len(t.column) for t in trees])
    first_leaf = np.cumsum([0] + [t.num_leaves for t in trees])
    start = np.cumsum([0] + [len(c) for c in cuts])
    values = np.concatenate([*cuts, np.zeros(1, np.float32)])
    nodes = np.zeros(roots[-1], NODE)
    for k, tree in enumerate(trees):
        part = nodes[roots[k] : roots[k + 1]]
        inner = tree.column >= 0
        column = np.where(inner, tree.column, 0)
        part["first"] = np.where(inner, columns.first[column], -1)
        part["second"] = np.where(inner, columns.second[column], -1)
        part["threshold"] = np.where(inner, values[np.where(inner, start[column] + tree.cut, 0)], 0)
        part["child"] = tree.child + np.where(inner, roots[k], first_leaf[k])
    return Trees(nodes, roots[:-1].astype(np.int32), int(first_leaf[-1]))
