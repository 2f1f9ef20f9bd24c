from __future__ import annotations

import numpy as np
import pytest
from clothrf_forest.config import ForestConfig
from clothrf_forest.policy import Forest

from clothrf_core.testing.policy import check_policy, synthetic_view

SETTINGS = {
    "default": {},
    "paper": {
        "trees": 10, "base": "none", "target_frame": "world", "min_impurity_decrease": 1e-4,
        "bootstrap": "rows", "leaves": "mean", "use_anchor": False, "topology": "entropy-labels",
    },
    "variance": {"topology": "variance"},
    "pairs": {"pairs": 30},
    "mean leaves": {"leaves": "mean"},
    "refined": {"leaves": "refined"},
    "stopped out of bag": {"min_impurity_decrease": "oob"},
    "k-means": {"labels": {"method": "k-means", "clusters": 25}},
    "scikit-learn": {"engine": "scikit-learn", "trees": 3},
}  # fmt: skip


@pytest.mark.parametrize("setting", SETTINGS)
def test_the_forest_keeps_the_contract_of_policies(setting: str) -> None:
    config = ForestConfig.model_validate({"trees": 8, **SETTINGS[setting]})

    check_policy(lambda: Forest(config), synthetic_view())


def test_one_thread_and_two_give_the_same_file(tmp_path) -> None:
    view = synthetic_view()
    for threads in (1, 2):
        forest = Forest(ForestConfig(trees=6, threads=threads))
        forest.fit(view, np.random.default_rng(3))
        folder = tmp_path / str(threads)
        folder.mkdir()
        forest.save(folder)

    for name in ("policy.json", "forest.npz"):
        assert (tmp_path / "1" / name).read_bytes() == (tmp_path / "2" / name).read_bytes()
