"""The same tree grown by scikit-learn: the fallback without numba, and the oracle of the tests.

It sees the same levels and follows the same rule, so the policy file is of the same kind.
"""

from __future__ import annotations

import warnings

import numpy as np
from sklearn.tree import DecisionTreeClassifier, DecisionTreeRegressor

from clothrf_core.errors import DataError
from clothrf_forest.trees import Growth, Problem, Tree, Weights


def sklearn_grower(problem: Problem, weights: Weights, growth: Growth, seed: int) -> Tree:
    """A tree of scikit-learn on the levels, as a `Tree`."""
    if growth.node_local:
        raise DataError('forest: gain_mode = "node_local" needs numba: pip install "clothrf[fast]"')
    rule = {
        "max_depth": growth.max_depth,
        "max_features": growth.max_features,
        "min_impurity_decrease": growth.min_gain,
        "min_samples_leaf": growth.min_samples_leaf,
        "random_state": seed % 2**32,
    }
    held = np.flatnonzero(weights)
    levels = problem.codes.T.astype(np.float32)
    if problem.num_labels:
        tree = DecisionTreeClassifier(criterion="entropy", **rule)
        with warnings.catch_warnings():
            # Many labels are meant; scikit-learn suspects a regression.
            warnings.filterwarnings("ignore", message="The number of unique classes")
            tree.fit(levels[held], problem.labels[held], sample_weight=weights[held])
    else:
        tree = DecisionTreeRegressor(**rule)
        # scikit-learn reduces the mean variance over outputs, the kernel their sum.
        scaled = problem.targets * np.sqrt(problem.targets.shape[1])
        tree.fit(levels[held], scaled[held], sample_weight=weights[held])
    return _as_tree(tree.tree_, tree.apply(levels))


def _as_tree(found: object, place: np.ndarray) -> Tree:
    """Renumber so that siblings are neighbours, parents come first and leaves count up."""
    left: np.ndarray = found.children_left  # type: ignore[attr-defined]
    right: np.ndarray = found.children_right  # type: ignore[attr-defined]
    feature: np.ndarray = found.feature  # type: ignore[attr-defined]
    threshold: np.ndarray = found.threshold  # type: ignore[attr-defined]
    impurity: np.ndarray = found.impurity  # type: ignore[attr-defined]
    size: np.ndarray = found.weighted_n_node_samples  # type: ignore[attr-defined]
    m = len(left)
    column = np.full(m, -1, np.int32)
    cut = np.zeros(m, np.uint8)
    child = np.zeros(m, np.int32)
    gain = np.zeros(m)
    leaf_of = np.zeros(m, np.int32)
    order = [0]
    leaves = 0
    for new, old in enumerate(order):
        a, b = int(left[old]), int(right[old])
        if a < 0:
            child[new] = leaf_of[old] = leaves
            leaves += 1
            continue
        column[new] = feature[old]
        cut[new] = int(np.floor(threshold[old]))
        child[new] = len(order)
        gain[new] = (
            size[old] * impurity[old] - size[a] * impurity[a] - size[b] * impurity[b]
        ) / size[0]
        order += [a, b]
    return Tree(column, cut, child, gain, leaf_of[place], leaves)
