from __future__ import annotations

import importlib.util
from pathlib import Path

import numpy as np
import pytest
from clothrf_forest.growth import SCALE, entropy_table
from clothrf_forest.growth import grow_tree as compiled
from clothrf_forest.reference import sklearn_grower
from clothrf_forest.trees import Growth, Problem, numba_grower
from sklearn.tree import DecisionTreeClassifier, DecisionTreeRegressor

_spec = importlib.util.spec_from_file_location("twins", Path(__file__).with_name("twins.py"))
assert _spec is not None
assert _spec.loader is not None
twins = importlib.util.module_from_spec(_spec)
_spec.loader.exec_module(twins)


def problem(seed: int = 0, n: int = 120, columns: int = 9, labels: int = 7):
    rng = np.random.default_rng(seed)
    codes = rng.integers(0, 40, (columns, n)).astype(np.uint8)
    codes[0] = 3
    hidden = codes[1].astype(int) // 10 + 2 * (codes[2] > 20)
    label = ((hidden + (rng.random(n) < 0.2)) % labels).astype(np.int32)
    # Whole numbers: sums are exact, so that ties between columns are ties in any order.
    targets = np.rint(10.0 * rng.normal(size=(n, 3)) + codes[3:6].T)
    weights = np.bincount(rng.integers(n, size=n), minlength=n).astype(np.uint8)
    return codes, label, labels, targets, weights


RULES = {
    "every column": (20, 0.0, False, 9, 1, 0),
    "three columns": (20, 0.0, False, 3, 1, 0),
    "weighted stop": (20, 0.02, False, 4, 1, 0),
    "node-local stop": (20, 0.4, True, 4, 1, 0),
    "shallow": (3, 0.0, False, 4, 1, 0),
    "five rows a leaf": (20, 0.0, False, 4, 5, 0),
    "two columns always": (20, 0.0, False, 2, 1, 2),
}


@pytest.mark.parametrize("rule", RULES)
@pytest.mark.parametrize("by_label", [True, False])
def test_the_compiled_tree_equals_its_numpy_twin(rule: str, by_label: bool) -> None:
    codes, label, labels, targets, weights = problem()
    count = labels if by_label else 0
    table = entropy_table(int(weights.sum()))

    for seed in range(3):
        found = compiled(
            codes, label, count, targets, weights, table, np.uint64(seed), *RULES[rule]
        )
        wanted = twins.grow_tree(codes, label, count, targets, weights, seed, *RULES[rule])

        for a, b in zip(found[:3], wanted[:3], strict=True):
            np.testing.assert_array_equal(a, b)
        np.testing.assert_allclose(found[3], wanted[3], rtol=1e-9, atol=1e-12)
        np.testing.assert_array_equal(found[4], wanted[4])
        assert found[5] == wanted[5]


def test_the_table_holds_c_log_c_in_fixed_point() -> None:
    table = entropy_table(1000)

    assert table[0] == table[1] == 0
    assert table[2] / SCALE == 2.0
    np.testing.assert_allclose(table[1000] / SCALE, 1000 * np.log2(1000), rtol=1e-12)


@pytest.mark.parametrize("by_label", [True, False])
def test_with_every_column_it_separates_as_well_as_scikit_learn(by_label: bool) -> None:
    codes, label, labels, targets, weights = problem(n=400)
    growth = Growth(6, 0.0, False, 9, 1)
    of = Problem(codes, label, labels if by_label else 0, targets)

    ours = numba_grower(of, weights, growth, 0)
    theirs = sklearn_grower(of, weights, growth, 0)

    # The first split has one best answer; deeper ties may be broken either way.
    assert (ours.column[0], ours.gain[0]) == (
        theirs.column[0],
        pytest.approx(theirs.gain[0], rel=1e-6),
    )
    assert ours.num_leaves == pytest.approx(theirs.num_leaves, rel=0.1)
    assert ours.gain.sum() == pytest.approx(theirs.gain.sum(), rel=0.03)


def test_scikit_learn_trees_answer_the_same_after_conversion() -> None:
    codes, label, labels, targets, weights = problem(n=300)
    held = np.flatnonzero(weights)
    levels = codes.T.astype(np.float32)
    growth = Growth(8, 0.0, False, 3, 1)

    for num_labels, kind in ((labels, DecisionTreeClassifier), (0, DecisionTreeRegressor)):
        found = sklearn_grower(Problem(codes, label, num_labels, targets), weights, growth, 5)
        rule = {"max_depth": 8, "max_features": 3, "random_state": 5}
        if num_labels:
            tree = kind(criterion="entropy", **rule)
            tree.fit(levels[held], label[held], sample_weight=weights[held])
        else:
            tree = kind(**rule)
            tree.fit(levels[held], np.sqrt(3) * targets[held], sample_weight=weights[held])
        theirs = tree.apply(levels)

        pairs = {(int(a), int(b)) for a, b in zip(found.leaf, theirs, strict=True)}
        assert len(pairs) == found.num_leaves == tree.get_n_leaves()


def test_a_tree_stopped_earlier_is_the_same_tree_cut_back() -> None:
    codes, label, labels, targets, weights = problem(n=400)
    of = Problem(codes, label, labels, targets)

    deep = numba_grower(of, weights, Growth(20, 0.0, False, 4, 1), 3)
    short = numba_grower(of, weights, Growth(20, 0.01, False, 4, 1), 3)

    def shape(tree, node=0, least=0.0):
        if tree.column[node] < 0 or tree.gain[node] + 2.2e-16 < least:
            return None
        c = tree.child[node]
        return (
            int(tree.column[node]),
            int(tree.cut[node]),
            shape(tree, c, least),
            shape(tree, c + 1, least),
        )

    assert shape(deep, least=0.01) == shape(short)
    assert short.num_leaves < deep.num_leaves


def test_labels_of_one_kind_give_one_leaf() -> None:
    codes, label, _, targets, weights = problem()

    tree = numba_grower(
        Problem(codes, np.zeros_like(label), 1, targets), weights, Growth(20, 0.0, False, 9, 1), 0
    )

    assert tree.num_leaves == 1


def test_rows_out_of_bag_do_not_shape_the_tree() -> None:
    codes, label, labels, targets, weights = problem()
    out = weights == 0
    other = label.copy()
    other[out] = (other[out] + 1) % labels
    growth = Growth(20, 0.0, False, 3, 1)

    a = numba_grower(Problem(codes, label, labels, targets), weights, growth, 1)
    b = numba_grower(Problem(codes, other, labels, targets), weights, growth, 1)

    np.testing.assert_array_equal(a.cut, b.cut)
    np.testing.assert_array_equal(a.leaf, b.leaf)
