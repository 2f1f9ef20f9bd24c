from __future__ import annotations

import json
import subprocess
import sys

import clothrf_baselines
import numpy as np
import pytest
from clothrf_baselines.config import (
    BaselineConfig,
    CnnConfig,
    DepthNeighboursConfig,
    DictionaryConfig,
    HowNeighboursConfig,
    LassoConfig,
    MlpConfig,
    RidgeConfig,
    TreesConfig,
)

from clothrf_core.errors import DataError, FeatureMismatch, MissingDependency
from clothrf_core.registry import Registry
from clothrf_core.testing.policy import check_policy, synthetic_view
from clothrf_core.types import DatasetView, Features

REGISTRY = Registry.of(clothrf_baselines)
SMALL = {
    "constant": BaselineConfig(),
    "linear": BaselineConfig(),
    "ridge": RidgeConfig(folds=3),
    "mlp128": MlpConfig(epochs=12),
    "knn_how": HowNeighboursConfig(prefix="", k=3),
    "knn_depth64": DepthNeighboursConfig(),
    "vfd_sparse": DictionaryConfig(atoms=60, iterations=40, working_set=24),
    "vfd_lasso": LassoConfig(iterations=200),
    "forest_sklearn": TreesConfig(trees=8, threads=1),
    "extra_trees": TreesConfig(trees=8, threads=1),
    "cnn_depth": CnnConfig(epochs=2),
}
PLAIN = sorted(set(SMALL) - {"knn_depth64", "cnn_depth"})


def build(name, config=None):
    try:
        return REGISTRY.build("policy", name, config or SMALL[name])
    except MissingDependency as error:
        pytest.skip(str(error))


def depth_view(rows=60):
    """Small depth pictures of a square that moves with the hidden state."""
    view = synthetic_view(rows=rows, features=4, groups=6)
    extractor = REGISTRY.build("features", "depth64")
    move = (view.labels[:, 0, 0] - view.anchors).astype(np.float32)
    pictures = np.zeros((rows, 64, 64), np.float32)
    for picture, (x, y, z) in zip(pictures, move, strict=True):
        r, c = int(30 + 150 * x), int(30 + 150 * y)
        picture[r - 9 : r + 9, c - 9 : c + 9] = 0.5 + z
    values = np.concatenate([pictures.reshape(rows, -1), view.grasps.reshape(rows, -1)], axis=1)
    return DatasetView(
        features=values.astype(np.float32),
        names=extractor.names,
        anchors=view.anchors,
        labels=view.labels,
        tasks=view.tasks,
        groups=view.groups,
        grasps=view.grasps,
    )


def rms(policy, view, rows):
    errors = [
        policy.act(view.feature_row(row), task).targets - view.labels[row, t]
        for row in rows
        for t, task in enumerate(view.tasks)
    ]
    return float(np.sqrt(np.mean(np.square(errors))))


def test_all_baselines_are_tried_here():
    assert REGISTRY.names("policy") == sorted(SMALL)


@pytest.mark.parametrize("name", PLAIN)
def test_every_baseline_keeps_the_contract(name):
    check_policy(lambda: build(name))


@pytest.mark.parametrize("name", ["knn_depth64", "cnn_depth"])
def test_baselines_on_pictures_keep_the_contract(name):
    check_policy(lambda: build(name), depth_view())


@pytest.mark.parametrize("name", ["ridge", "forest_sklearn"])
@pytest.mark.parametrize("frame", ["anchor", "world"])
def test_the_contract_holds_in_both_frames_and_unscaled(name, frame):
    config = SMALL[name].model_copy(
        update={"target_frame": frame, "use_anchor": False, "scale_targets": False}
    )
    check_policy(lambda: build(name, config))


def test_everything_learns_more_than_the_constant():
    view = synthetic_view(rows=600, groups=30)
    train = np.flatnonzero(view.groups % 5 != 0)
    test = np.flatnonzero(view.groups % 5 == 0)
    errors = {}
    for name in PLAIN:
        policy = build(name)
        policy.fit(view.rows(train), np.random.default_rng(0))
        errors[name] = rms(policy, view, test)
    worst = errors.pop("constant")
    assert max(errors.values()) < 0.85 * worst, errors


def test_targets_follow_the_anchor_in_the_anchor_frame_only():
    view = synthetic_view()
    row = view.feature_row(0)
    moved = Features(row.values, row.names, row.anchor + 0.1)
    for frame, shift in (("anchor", 0.1), ("world", 0.0)):
        policy = build("constant", BaselineConfig(target_frame=frame))
        policy.fit(view, np.random.default_rng(0))
        before, after = (policy.act(f, "task 1").targets for f in (row, moved))
        np.testing.assert_allclose(after - before, shift, atol=1e-12)


def test_a_prefix_chooses_features():
    view = synthetic_view(features=24)
    policy = build("ridge", RidgeConfig(prefix="feature 1", use_anchor=False))
    policy.fit(view, np.random.default_rng(0))
    row = view.feature_row(0)
    other = np.array(row.values)
    other[[2, 3, 20]] += 1.0  # 'feature 2', 'feature 3', 'feature 20'
    same = policy.act(Features(other, row.names, row.anchor), "task 0")
    assert np.array_equal(same.targets, policy.act(row, "task 0").targets)
    other[11] += 1.0
    changed = policy.act(Features(other, row.names, row.anchor), "task 0")
    assert not np.array_equal(changed.targets, same.targets)


def test_features_of_the_wrong_kind_are_refused_with_advice():
    for name in ("knn_depth64", "knn_how"):
        with pytest.raises(FeatureMismatch, match="Choose the extractor that makes them"):
            build(name, type(SMALL[name])()).fit(synthetic_view(), np.random.default_rng(0))


def test_an_invalid_picture_is_answered_with_the_mean_and_no_confidence():
    view = synthetic_view()
    policy = build("ridge")
    policy.fit(view, np.random.default_rng(0))
    blank = Features(np.zeros(24, np.float32), view.names, np.zeros(3), valid=False)
    action = policy.act(blank, "task 2")
    assert action.confidence == 0.0
    np.testing.assert_allclose(action.targets, view.labels[:, 2].mean(axis=0))


def test_an_unknown_task_names_the_nearest():
    policy = build("constant")
    with pytest.raises(DataError, match="call fit or load first"):
        policy.act(synthetic_view().feature_row(0), "task 0")
    policy.fit(synthetic_view(), np.random.default_rng(0))
    with pytest.raises(DataError, match="Did you mean 'task 0'"):
        policy.act(synthetic_view().feature_row(0), "tusk 0")


def test_no_rows_are_refused():
    with pytest.raises(DataError, match="expected rows to learn from"):
        build("ridge").fit(synthetic_view().rows(slice(0, 0)), np.random.default_rng(0))


@pytest.mark.parametrize("name", PLAIN)
def test_one_roll_out_and_a_constant_feature_are_enough(name):
    view = synthetic_view(rows=40, groups=1)
    values = np.array(view.features)
    values[:, 3] = 7.0
    view = DatasetView(
        features=values, names=view.names, anchors=view.anchors, labels=view.labels,
        tasks=view.tasks, groups=view.groups, grasps=view.grasps,
    )  # fmt: skip
    policy = build(name)
    policy.fit(view, np.random.default_rng(0))
    assert np.isfinite(policy.act(view.feature_row(5), "task 0").targets).all()


def test_a_policy_of_another_plugin_is_refused(tmp_path):
    policy = build("ridge")
    policy.fit(synthetic_view(), np.random.default_rng(0))
    policy.save(tmp_path)
    with pytest.raises(DataError, match="expected a policy of plugin 'linear', got 'ridge'"):
        build("linear").load(tmp_path)


def test_a_meddled_description_is_refused(tmp_path):
    policy = build("extra_trees")
    policy.fit(synthetic_view(), np.random.default_rng(0))
    policy.save(tmp_path)
    about = json.loads((tmp_path / "policy.json").read_text())
    for key, value in (("tasks", ["one"]), ("names", ["a", "b"]), ("config", {"trees": "many"})):
        (tmp_path / "policy.json").write_text(json.dumps({**about, key: value}))
        with pytest.raises(DataError):
            build("extra_trees").load(tmp_path)


def test_loading_restores_the_configuration(tmp_path):
    policy = build("constant", BaselineConfig(target_frame="world"))
    policy.fit(synthetic_view(), np.random.default_rng(0))
    policy.save(tmp_path)
    assert build("constant").load(tmp_path).config.target_frame == "world"


def test_listing_the_plugin_imports_nothing_heavy():
    code = (
        "import sys, clothrf_baselines as p; p.clothrf_policies(); p.clothrf_features();"
        "print([m for m in ('sklearn', 'scipy', 'torch', 'cv2') if m in sys.modules])"
    )
    found = subprocess.run([sys.executable, "-c", code], capture_output=True, text=True, check=True)
    assert found.stdout.strip() == "[]"
