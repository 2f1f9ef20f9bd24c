from __future__ import annotations

import numpy as np
import pytest
from clothrf_forest.confidence import calibrated, rising
from clothrf_forest.config import ForestConfig
from clothrf_forest.policy import Forest
from hypothesis import given
from hypothesis import strategies as st
from sklearn.isotonic import isotonic_regression

from clothrf_core.testing.policy import synthetic_view
from clothrf_core.types import Features


@given(st.lists(st.floats(-10, 10), min_size=1, max_size=40))
def test_rising_is_isotonic_regression(values: list[float]) -> None:
    np.testing.assert_allclose(
        rising(np.array(values)), isotonic_regression(np.array(values)), atol=1e-9
    )


def test_the_share_of_small_errors_is_what_was_seen() -> None:
    rng = np.random.default_rng(0)
    spread = rng.uniform(0.005, 0.05, (40_000, 1))
    error = np.abs(spread * rng.normal(size=spread.shape))

    found = calibrated(spread, error, 0.02)

    from scipy.stats import norm

    wanted = 2.0 * norm.cdf(0.02 / found.doubt[0]) - 1.0
    np.testing.assert_allclose(found.share[0], wanted, atol=0.04)
    np.testing.assert_allclose(found.error[0], found.doubt[0] * np.sqrt(2 / np.pi), rtol=0.1)


def test_confidence_falls_and_the_expected_error_rises_with_the_doubt() -> None:
    rng = np.random.default_rng(1)

    found = calibrated(rng.random((300, 2)), rng.random((300, 2)), 0.5)

    assert (np.diff(found.share, axis=1) <= 0).all()
    assert (np.diff(found.error, axis=1) >= 0).all()
    assert (np.diff(found.doubt, axis=1) >= 0).all()


def test_no_bin_is_ever_certain() -> None:
    found = calibrated(np.arange(32.0)[:, None], np.zeros((32, 1)), 0.02)

    assert found.share.max() < 1.0


def test_without_rows_nothing_is_known() -> None:
    assert (calibrated(np.zeros((0, 3)), np.zeros((0, 3)), 0.02).share == 0.5).all()


def test_confidence_on_new_roll_outs_is_the_chance_of_a_small_error() -> None:
    view = synthetic_view(rows=3000, tasks=1, groups=150)
    unseen = view.groups >= 100
    train, test = view.rows(~unseen), view.rows(unseen)
    forest = Forest(ForestConfig(trees=30))
    forest.fit(train, np.random.default_rng(0))

    actions = [forest.act(test.feature_row(i), "task 0") for i in range(len(test))]

    wrong = np.array([a.targets for a in actions]) - test.labels[:, 0]
    small = np.sqrt((wrong**2).mean(axis=(1, 2))) < 0.02
    stated = np.array([a.confidence for a in actions])
    assert stated.mean() == pytest.approx(small.mean(), abs=0.1)
    sure = stated > np.median(stated)
    assert small[sure].mean() > small[~sure].mean()


def test_rows_unlike_all_others_have_no_confidence() -> None:
    view = synthetic_view(rows=1200, tasks=1, groups=60)
    forest = Forest(ForestConfig(trees=10))
    forest.fit(view, np.random.default_rng(0))
    rng = np.random.default_rng(1)

    known = [forest.act(view.feature_row(i), "task 0").confidence for i in range(0, 1200, 10)]
    strange = [
        forest.act(
            Features(rng.normal(size=24).astype(np.float32) * 3.0, view.names, view.anchors[0]),
            "task 0",
        ).confidence
        for _ in range(50)
    ]

    assert max(strange) == 0.0
    assert np.median(known) > 0.1


def test_novelty_can_be_switched_off() -> None:
    view = synthetic_view(tasks=1)
    forest = Forest(ForestConfig.model_validate({"trees": 5, "confidence": {"novelty": False}}))
    forest.fit(view, np.random.default_rng(0))

    strange = Features(np.full(24, 50.0, np.float32), view.names, view.anchors[0])

    assert forest.act(strange, "task 0").confidence > 0.0
