"""The stopping rule chosen out of bag: grow once to the end, cut back, keep the best.

Every node draws from its own random state, so a tree cut back to a larger least gain is the tree
that would have been grown with it. One growth serves the whole ladder.
"""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from clothrf_core.types import Float, Float32
from clothrf_forest.leaves import leaf_numbers, mean_leaves, out_of_bag
from clothrf_forest.linear import linear_leaves
from clothrf_forest.trees import Tree

LADDER = (1e-4, 2e-4, 5e-4, 1e-3, 2e-3, 5e-3, 1e-2)
JUDGES = 30
SLACK = 1.002


def chosen_gain(
    trees: list[Tree],
    weights: NDArray[np.uint8],
    targets: Float,
    tasks: int,
    *,
    asked: Float32 | None = None,
    penalty: float = 0.05,
) -> float:
    """The largest least gain whose out-of-bag error is within 0.2 % of the best.

    Args:
        trees: grown with the first gain of `LADDER`; the first 30 are asked.
        weights: (K, N) their samples.
        targets: (N, D) what leaves answer.
        tasks: T.
        asked: (N, h) projections of linear leaves; None = leaves hold means.
        penalty: of linear leaves.
    """
    judges, weights = trees[:JUDGES], weights[:JUDGES]
    errors = []
    for gain in LADDER:
        cut = [cut_back(tree, gain) for tree in judges]
        leaf = leaf_numbers(cut)
        leaves = mean_leaves(leaf, sum(t.num_leaves for t in cut), weights, targets, tasks)
        if asked is not None:
            leaves = linear_leaves(leaves, leaf, weights, targets, asked, penalty)
        found = out_of_bag(leaf, weights, leaves, tasks, asked)
        errors.append(float(((targets[found.rows] - found.prediction) ** 2).sum()))
    least = SLACK**2 * min(errors)
    return max(gain for gain, error in zip(LADDER, errors, strict=True) if error <= least)


def cut_back(tree: Tree, least: float) -> Tree:
    """The tree without the splits that gain less than `least`, and without what hangs below."""
    column, cut, child, gain = [], [], [], []
    owner = np.full(tree.num_leaves, -1, np.int32)
    level = np.zeros(1, np.int64)
    done = np.full(1, -1, np.int32)
    nodes, leaves = 1, 0
    while level.size:
        inner = tree.column[level] >= 0
        open_ = done < 0
        split = open_ & inner & (tree.gain[level] + 2.2e-16 >= least)
        stop = open_ & ~split
        done[stop] = leaves + np.arange(int(stop.sum()), dtype=np.int32)
        here = np.flatnonzero(open_)
        is_split = split[here]
        numbers = np.where(is_split, nodes + 2 * (np.cumsum(is_split) - 1), done[here])
        column.append(np.where(is_split, tree.column[level[here]], -1))
        cut.append(np.where(is_split, tree.cut[level[here]], 0))
        child.append(numbers)
        gain.append(np.where(is_split, tree.gain[level[here]], 0.0))
        nodes += 2 * int(split.sum())
        leaves += int(stop.sum())
        owner[tree.child[level[~inner]]] = done[~inner]
        below = level[inner]
        level = (
            np.stack([tree.child[below], tree.child[below] + 1], axis=1).ravel().astype(np.int64)
        )
        done = np.repeat(done[inner], 2)
    return Tree(
        column=np.concatenate(column).astype(np.int32),
        cut=np.concatenate(cut).astype(np.uint8),
        child=np.concatenate(child).astype(np.int32),
        gain=np.concatenate(gain),
        leaf=owner[tree.leaf],
        num_leaves=leaves,
    )
