from __future__ import annotations

import numpy as np
import pytest
from clothrf_forest.stopping import LADDER, chosen_gain, cut_back
from clothrf_forest.trees import Growth, Problem, Tree, numba_grower, samples


def problem(noise: float, n: int = 600) -> Problem:
    rng = np.random.default_rng(0)
    codes = rng.integers(0, 200, (8, n)).astype(np.uint8)
    targets = (codes[0] > 100) * 1.0 + noise * rng.normal(size=n)
    return Problem(codes, np.zeros(n, np.int32), 0, targets[:, None] / targets.std())


def partition(tree: Tree) -> set[frozenset[int]]:
    return {frozenset(np.flatnonzero(tree.leaf == k).tolist()) for k in range(tree.num_leaves)}


@pytest.mark.parametrize("gain", [1e-3, 1e-2, 0.5, 2.0])
def test_cutting_back_gives_the_tree_that_would_have_been_grown(gain: float) -> None:
    of = problem(0.5)
    weights = np.ones(600, np.uint8)
    deep = numba_grower(of, weights, Growth(20, 1e-4, False, 3, 1), 7)

    cut = cut_back(deep, gain)
    grown = numba_grower(of, weights, Growth(20, gain, False, 3, 1), 7)

    assert partition(cut) == partition(grown)
    assert cut.num_leaves == grown.num_leaves == int((cut.column < 0).sum())
    assert sorted(cut.gain) == sorted(grown.gain)


def test_a_tree_that_was_cut_back_sends_rows_to_the_leaves_it_names() -> None:
    of = problem(0.5)
    tree = cut_back(numba_grower(of, np.ones(600, np.uint8), Growth(20, 0, False, 3, 1), 7), 3e-3)

    for row in range(0, 600, 37):
        node = 0
        while tree.column[node] >= 0:
            right = of.codes[tree.column[node], row] > tree.cut[node]
            node = tree.child[node] + right
        assert tree.child[node] == tree.leaf[row]


def test_noise_asks_for_few_leaves() -> None:
    of = problem(1.0)
    seeds = np.arange(20)
    weights = samples("rows", 1.0, np.arange(600), seeds)
    growth = Growth(20, LADDER[0], False, 3, 1)
    trees = [numba_grower(of, w, growth, int(s)) for w, s in zip(weights, seeds, strict=True)]

    gain = chosen_gain(trees, weights, of.targets, 1)

    assert gain >= 2e-3
    cut = sum(cut_back(tree, gain).num_leaves for tree in trees)
    assert cut < 0.2 * sum(tree.num_leaves for tree in trees)


def test_leaves_converge_as_roll_outs_are_added() -> None:
    from clothrf_forest.config import ForestConfig
    from clothrf_forest.policy import Forest

    from clothrf_core.testing.policy import synthetic_view

    view = synthetic_view(rows=3000, tasks=1, groups=150)
    leaves = [
        Forest(ForestConfig(trees=20)).fit(view.rows(view.groups < n), np.random.default_rng(n))
        for n in (100, 150)
    ]

    assert abs(leaves[1]["leaves"] / leaves[0]["leaves"] - 1.0) < 0.04
