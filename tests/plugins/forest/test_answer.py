from __future__ import annotations

import numpy as np
import pytest
from clothrf_forest.answer import answer_in_numpy, prepared
from clothrf_forest.compiled import answer, interpolated
from clothrf_forest.config import ForestConfig
from clothrf_forest.policy import Forest

from clothrf_core.testing.policy import synthetic_view

SETTINGS = [
    {},
    {"base": "none", "pairs": 40},
    {"base": "ridge"},
    {"target_frame": "world", "use_anchor": False},
    {"topology": "entropy-labels", "oblique": False},
    {"leaves": "mean"},
]


@pytest.mark.parametrize("setting", SETTINGS)
def test_the_compiled_answer_equals_the_numpy_one(setting: dict[str, object]) -> None:
    view = synthetic_view(tasks=2)
    forest = Forest(ForestConfig.model_validate({"trees": 12, **setting}))
    forest.fit(view, np.random.default_rng(0))

    for task in range(2):
        of = prepared(forest.model, task)
        for i in range(0, len(view), 9):
            ours, twin = np.empty(10), np.empty(10)
            row = view.feature_row(i)
            answer(row.values, row.anchor, of, ours)
            answer_in_numpy(row.values, row.anchor, of, twin)
            np.testing.assert_allclose(ours, twin, rtol=1e-9, atol=1e-8)


def test_interpolation_equals_numpys() -> None:
    knots = np.array([0.1, 0.2, 0.2, 0.5])
    values = np.array([1.0, 0.8, 0.6, 0.1])

    for x in (0.0, 0.1, 0.15, 0.3, 0.5, 2.0):
        assert interpolated(x, knots, values) == pytest.approx(np.interp(x, knots, values))


def test_without_numba_the_policy_acts_the_same(monkeypatch) -> None:
    view = synthetic_view(tasks=1)
    forest = Forest(ForestConfig(trees=5))
    forest.fit(view, np.random.default_rng(0))
    wanted = forest.act(view.feature_row(3), "task 0")

    monkeypatch.setattr(forest, "_answer", answer_in_numpy)
    found = forest.act(view.feature_row(3), "task 0")

    np.testing.assert_allclose(found.targets, wanted.targets, rtol=1e-9)
    assert found.confidence == pytest.approx(wanted.confidence)
