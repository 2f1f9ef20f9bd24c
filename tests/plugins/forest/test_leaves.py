from __future__ import annotations

import numpy as np
from clothrf_forest.leaves import mean_leaves, out_of_bag
from clothrf_forest.linear import linear_leaves
from clothrf_forest.refined import answers, refined_leaves, solved
from clothrf_forest.trees import samples
from sklearn.linear_model import Ridge


def grown(seed: int = 0, n: int = 240, trees: int = 12, leaves: int = 6):
    """Random partitions of rows, and targets that follow partly from them."""
    rng = np.random.default_rng(seed)
    leaf = rng.integers(leaves, size=(trees, n)).astype(np.int32)
    leaf += leaves * np.arange(trees, dtype=np.int32)[:, None]
    effect = rng.normal(size=(trees * leaves, 6))
    targets = effect[leaf].mean(0) + 0.05 * rng.normal(size=(n, 6))
    groups = np.repeat(np.arange(n // 10), 10)
    weights = samples("groups", 1.0, groups, np.arange(trees))
    return leaf, trees * leaves, weights, targets, groups % 6


def test_a_leaf_answers_the_weighted_mean_of_its_sample_rows() -> None:
    leaf, num, weights, targets, _ = grown()

    found = mean_leaves(leaf, num, weights, targets, 2)

    for k, label in ((0, 3), (5, 31)):
        rows = leaf[k] == label
        w = weights[k, rows].astype(float)
        mean = np.average(targets[rows], axis=0, weights=w)
        variance = np.average((targets[rows] - mean) ** 2, axis=0, weights=w)
        np.testing.assert_allclose(found.values[label], mean, rtol=1e-5)
        np.testing.assert_allclose(
            found.variance[label], variance.reshape(2, 3).mean(axis=1), rtol=1e-4
        )


def test_out_of_bag_rows_are_answered_by_trees_that_did_not_see_them() -> None:
    leaf, num, weights, targets, _ = grown()
    leaves = mean_leaves(leaf, num, weights, targets, 2)

    found = out_of_bag(leaf, weights, leaves, 2)

    for at in (0, 17, len(found.rows) - 1):
        row = found.rows[at]
        asked = weights[:, row] == 0
        votes = leaves.values[leaf[asked, row]].astype(float)
        assert asked.sum() >= 3
        np.testing.assert_allclose(found.prediction[at], votes.mean(axis=0), atol=1e-9)
        between = votes.var(axis=0).reshape(2, 3).mean(axis=1)
        within = leaves.variance[leaf[asked, row]].mean(axis=0)
        np.testing.assert_allclose(found.spread[at], np.sqrt(between + within), rtol=1e-5)


def test_samples_of_roll_outs_take_or_leave_them_as_a_whole() -> None:
    groups = np.repeat(np.arange(20), 5)

    weights = samples("groups", 1.0, groups, np.arange(8))

    assert (weights.reshape(8, 20, 5) == weights.reshape(8, 20, 5)[:, :, :1]).all()
    assert (weights == 0).any(axis=1).all()


def test_few_roll_outs_are_sampled_by_rows() -> None:
    groups = np.repeat(np.arange(3), 40)

    weights = samples("groups", 1.0, groups, np.arange(4))

    assert (weights.sum(axis=1) == 120).all()
    assert len(set(weights[0, :40])) > 1


def test_a_subsample_without_replacement_holds_each_row_at_most_once() -> None:
    weights = samples("none", 0.5, np.arange(100), np.arange(4))

    assert (weights.sum(axis=1) == 50).all()
    assert weights.max() == 1


def test_conjugate_gradients_solve_the_regularised_least_squares() -> None:
    leaf, num, weights, targets, _ = grown()
    indicator, rows = answers(leaf, weights == 0, num)
    dense = indicator.toarray()
    diagonal = (dense**2).sum(0)
    theta = 2.0 * diagonal.sum() / (diagonal > 0).sum()

    found = solved(indicator, targets[rows], 2.0)

    wanted = np.linalg.solve(dense.T @ dense + theta * np.eye(num), dense.T @ targets[rows])
    np.testing.assert_allclose(found, wanted, atol=1e-4)


def test_refined_leaves_help_where_leaves_act_together() -> None:
    leaf, num, weights, targets, fold = grown(n=2400)
    leaves = mean_leaves(leaf, num, weights, targets, 2)
    unseen = np.random.default_rng(9).permutation(2400)[:600]
    kept = np.setdiff1d(np.arange(2400), unseen)

    refined, theta = refined_leaves(
        leaves, leaf[:, kept], weights[:, kept], targets[kept], fold[kept]
    )

    def error(of) -> float:
        found = of.values[leaf[:, unseen]].astype(float).mean(0)
        return float(((found - targets[unseen]) ** 2).mean())

    assert np.isfinite(theta)
    assert error(refined) < 0.8 * error(leaves)


def test_a_linear_leaf_is_ridge_regression_on_its_sample_rows() -> None:
    leaf, num, weights, targets, _ = grown()
    asked = np.random.default_rng(3).normal(size=(240, 2)).astype(np.float32)
    targets = targets + asked @ np.random.default_rng(4).normal(size=(2, 6))

    found = linear_leaves(
        mean_leaves(leaf, num, weights, targets, 2), leaf, weights, targets, asked, 0.1
    )

    rows = np.flatnonzero((leaf[2] == 14) & (weights[2] > 0))
    w = weights[2, rows].astype(float)
    penalty = 0.1 * asked.astype(float).var(axis=0).mean() * w.sum()
    wanted = Ridge(alpha=penalty).fit(asked[rows], targets[rows], sample_weight=w)
    label = np.full(240, 14, np.int32)
    np.testing.assert_allclose(found.answers(label, asked), wanted.predict(asked), atol=1e-4)


def test_leaves_no_row_reached_have_no_slope() -> None:
    leaf, num, weights, targets, _ = grown()
    asked = np.ones((240, 1), np.float32)

    found = linear_leaves(
        mean_leaves(leaf, num + 3, weights, targets, 1), leaf, weights, targets, asked, 0.1
    )

    assert np.isfinite(found.slopes).all()
    assert not found.slopes[num:].any()
