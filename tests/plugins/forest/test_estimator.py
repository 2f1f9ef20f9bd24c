from __future__ import annotations

import numpy as np
from clothrf_forest.estimator import WrinkleForestRegressor
from sklearn.datasets import make_friedman1
from sklearn.model_selection import GroupKFold, cross_val_score
from sklearn.utils.estimator_checks import check_estimator


def test_it_passes_scikit_learns_own_checks() -> None:
    results = check_estimator(WrinkleForestRegressor(trees=5), on_skip=None)

    assert {r["status"] for r in results} <= {"passed", "skipped"}


def test_it_works_in_cross_validation_by_groups() -> None:
    X, y = make_friedman1(600, noise=0.5, random_state=0)
    groups = np.arange(600) // 20

    scores = cross_val_score(
        WrinkleForestRegressor(trees=40, max_features=10, random_state=0),
        X,
        y,
        groups=groups,
        cv=GroupKFold(3),
    )

    assert scores.mean() > 0.8


def test_several_targets_keep_their_columns() -> None:
    X, y = make_friedman1(400, noise=0.1, random_state=0)
    table = np.stack([y, -y, 2.0 * y + 5.0, np.ones_like(y)], axis=1)

    found = WrinkleForestRegressor(trees=20, random_state=0).fit(X, table).predict(X)

    assert found.shape == table.shape
    np.testing.assert_allclose(found[:, 1], -found[:, 0], atol=0.2)
    np.testing.assert_allclose(found[:, 3], 1.0)
