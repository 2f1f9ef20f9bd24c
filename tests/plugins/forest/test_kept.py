from __future__ import annotations

import dataclasses

import numpy as np
from clothrf_forest.config import ForestConfig
from clothrf_forest.policy import Forest

from clothrf_core.testing.policy import synthetic_view


def kept(change, base: str = "ridge") -> float:
    """How much of the trees is kept when `change` (n, F) -> (n,) is added to linear targets."""
    view = synthetic_view(rows=800, groups=40)
    rng = np.random.default_rng(1)
    x = rng.normal(size=view.features.shape).astype(np.float32)
    labels = np.zeros_like(view.labels) + x[:, 0, None, None, None]
    labels = 0.05 * (labels + change(x)[:, None, None, None]) + view.anchors[:, None, None]
    rows = dataclasses.replace(view, features=x, labels=labels)
    forest = Forest(ForestConfig.model_validate({"trees": 20, "base": base}))
    return float(forest.fit(rows, np.random.default_rng(2))["trees_kept"])


def test_trees_that_learnt_noise_are_silenced() -> None:
    noise = np.random.default_rng(3)

    assert kept(lambda x: noise.normal(size=len(x))) < 0.2


def test_trees_that_know_what_the_base_cannot_say_are_heard() -> None:
    assert kept(lambda x: 3.0 * (np.abs(x[:, 0]) > 1.0)) > 0.5


def test_without_a_base_all_of_them_are_heard() -> None:
    assert kept(lambda x: 3.0 * (np.abs(x[:, 0]) > 1.0), "none") == 1.0
