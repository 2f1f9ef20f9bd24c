from __future__ import annotations

import dataclasses

import numpy as np
import pytest
from clothrf_forest.config import ForestConfig
from clothrf_forest.policy import Forest

from clothrf_core.errors import FeatureMismatch
from clothrf_core.testing.policy import synthetic_view
from clothrf_core.types import DatasetView

VIEW = synthetic_view(rows=900, groups=45)
FEW = VIEW.rows(VIEW.groups < 12)
UNSEEN = VIEW.rows(VIEW.groups >= 36)
MORE = VIEW.rows(VIEW.groups < 36)
PAPER = {"topology": "entropy-labels", "base": "none", "leaves": "mean", "bootstrap": "rows"}


def built(view: DatasetView, **settings: object) -> Forest:
    forest = Forest(ForestConfig.model_validate({"trees": 20, **settings}))
    forest.fit(view, np.random.default_rng(0))
    return forest


def rms(forest: Forest, view: DatasetView) -> float:
    found = np.array(
        [[forest.act(view.feature_row(i), t).targets for t in view.tasks] for i in range(len(view))]
    )
    return float(np.sqrt(((found - view.labels) ** 2).mean()))


@pytest.mark.parametrize("settings", [{}, PAPER], ids=["default", "paper"])
def test_a_refilled_forest_keeps_its_trees_and_learns_from_more_rows(
    settings: dict[str, object],
) -> None:
    forest = built(FEW, **settings)
    trees, before = forest.model.trees.nodes.copy(), rms(forest, UNSEEN)

    facts = forest.refit(MORE, np.random.default_rng(1))

    np.testing.assert_array_equal(forest.model.trees.nodes, trees)
    assert facts["leaves"] == forest.model.trees.num_leaves
    assert rms(forest, UNSEEN) < 0.98 * before


def test_a_leaf_that_no_row_reaches_keeps_its_answer() -> None:
    forest = built(MORE, **PAPER)
    before = forest.model.values.copy()

    facts = forest.refit(MORE.rows(np.arange(3)), np.random.default_rng(1))

    same = (forest.model.values == before).all(axis=(0, 2))
    assert 0 < facts["empty_leaves"] <= same.sum()


def test_the_same_rows_and_seed_refill_to_the_same_bits() -> None:
    a, b = built(FEW), built(FEW)

    a.refit(MORE, np.random.default_rng(1))
    b.refit(MORE, np.random.default_rng(1))

    np.testing.assert_array_equal(a.model.values, b.model.values)
    np.testing.assert_array_equal(a.model.calibration.share, b.model.calibration.share)


def test_rows_with_other_features_are_refused() -> None:
    forest = built(FEW)
    other = dataclasses.replace(FEW, names=tuple(f"other {i}" for i in range(len(FEW.names))))

    with pytest.raises(FeatureMismatch, match="build it anew"):
        forest.refit(other, np.random.default_rng(0))
