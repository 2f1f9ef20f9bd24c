from __future__ import annotations

import dataclasses

import numpy as np
import pytest
from clothrf_forest.config import ForestConfig
from clothrf_forest.policy import Forest

from clothrf_core.errors import DataError, FeatureMismatch
from clothrf_core.testing.policy import synthetic_view
from clothrf_core.types import DatasetView, Features

VIEW = synthetic_view(rows=600, groups=30)


def fitted(view: DatasetView = VIEW, **settings: object) -> Forest:
    forest = Forest(ForestConfig.model_validate({"trees": 10, **settings}))
    forest.fit(view, np.random.default_rng(0))
    return forest


def rms(forest: Forest, view: DatasetView) -> float:
    found = np.array(
        [[forest.act(view.feature_row(i), t).targets for t in view.tasks] for i in range(len(view))]
    )
    return float(np.sqrt(((found - view.labels) ** 2).mean()))


def moved(view: DatasetView, by: np.ndarray) -> DatasetView:
    return dataclasses.replace(view, anchors=view.anchors + by, labels=view.labels + by)


def test_it_beats_a_constant_on_roll_outs_it_never_saw() -> None:
    unseen = VIEW.groups >= 24
    train, test = VIEW.rows(~unseen), VIEW.rows(unseen)
    constant = (train.labels - train.anchors[:, None, None]).mean(axis=0)
    wrong = test.labels - test.anchors[:, None, None] - constant

    assert rms(fitted(train, trees=30), test) < 0.5 * float(np.sqrt((wrong**2).mean()))


def test_targets_move_with_the_anchor() -> None:
    forest = fitted(use_anchor=False)
    row = VIEW.feature_row(0)
    shift = np.array([0.3, -0.2, 0.1])

    here = forest.act(row, "task 0").targets
    there = forest.act(dataclasses.replace(row, anchor=row.anchor + shift), "task 0").targets

    np.testing.assert_allclose(there - here, np.tile(shift, (2, 1)), atol=1e-12)


def test_in_the_world_frame_they_do_not() -> None:
    forest = fitted(use_anchor=False, target_frame="world")
    row = VIEW.feature_row(0)

    here = forest.act(row, "task 0").targets
    there = forest.act(dataclasses.replace(row, anchor=row.anchor + 1.0), "task 0").targets

    np.testing.assert_array_equal(here, there)


def test_labels_are_made_in_the_frame_of_the_targets() -> None:
    # All that differs between rows is where the cloth is: relative actions are one and the same.
    still = dataclasses.replace(
        VIEW, labels=np.repeat(VIEW.labels[:1], 600, axis=0) - VIEW.anchors[0]
    )
    far = dataclasses.replace(
        still,
        anchors=VIEW.anchors * 5.0,
        labels=still.labels + 5.0 * VIEW.anchors[:, None, None],
    )
    settings = {"topology": "entropy-labels", "base": "none", "use_anchor": False}

    relative = Forest(ForestConfig.model_validate({"trees": 3, **settings}))
    absolute = Forest(
        ForestConfig.model_validate({"trees": 3, "target_frame": "world", **settings})
    )

    assert relative.fit(far, np.random.default_rng(0))["leaves"] == 3
    assert absolute.fit(far, np.random.default_rng(0))["labels"] >= 20


def test_one_forest_of_three_tasks_is_nearly_as_good_as_three() -> None:
    unseen = VIEW.groups >= 24
    train, test = VIEW.rows(~unseen), VIEW.rows(unseen)

    def one(t: int, view: DatasetView) -> DatasetView:
        return dataclasses.replace(
            view, labels=view.labels[:, t : t + 1], tasks=view.tasks[t : t + 1]
        )

    joint = rms(fitted(train, trees=30), test)
    alone = [rms(fitted(one(t, train), trees=30), one(t, test)) for t in range(3)]

    assert joint < 1.1 * float(np.sqrt(np.mean(np.square(alone))))


def test_a_picture_that_is_not_valid_has_no_confidence() -> None:
    forest = fitted()
    row = VIEW.feature_row(0)

    found = forest.estimate(Features(row.values, row.names, row.anchor, valid=False), "task 0")

    assert found.confidence == 0.0
    assert found.expected_error == np.inf
    assert np.isfinite(found.targets).all()


def test_numbers_that_are_not_finite_have_no_confidence() -> None:
    forest = fitted()
    row = VIEW.feature_row(0)
    for bad in (np.nan, np.inf, -np.inf):
        values = row.values.copy()
        values[3] = bad

        found = forest.act(Features(values, row.names, row.anchor), "task 0")

        assert found.confidence == 0.0
        assert np.isfinite(found.targets).all()


def test_features_of_other_names_are_refused_with_the_first_that_differs() -> None:
    forest = fitted()
    row = VIEW.feature_row(0)
    names = (*row.names[:5], "something", *row.names[6:])

    with pytest.raises(FeatureMismatch) as raised:
        forest.act(Features(row.values, names, row.anchor), "task 0")

    assert str(raised.value) == (
        "forest: expected the 24 features it was fitted on, got 24; the first that differs is "
        "'something'. Use the feature extractor of the training run"
    )


def test_equal_names_in_another_tuple_are_accepted() -> None:
    forest = fitted()
    row = VIEW.feature_row(0)
    names = tuple("".join(list(name)) for name in row.names)

    forest.act(Features(row.values, names, row.anchor), "task 0")


def test_an_unknown_task_is_refused_with_the_nearest_name() -> None:
    with pytest.raises(DataError, match=r"not fitted for task 'task O'\. Did you mean 'task"):
        fitted().act(VIEW.feature_row(0), "task O")


def test_an_unfitted_forest_says_so() -> None:
    with pytest.raises(DataError, match="call fit or load first"):
        Forest(ForestConfig()).act(VIEW.feature_row(0), "task 0")


@pytest.mark.parametrize(
    ("change", "message"),
    [
        ({"labels": np.full_like(VIEW.labels, np.nan)}, "finite labels"),
        ({"features": np.full_like(VIEW.features, np.nan)}, "finite features"),
    ],
)
def test_rows_that_are_not_finite_are_refused(change: dict[str, np.ndarray], message: str) -> None:
    with pytest.raises(DataError, match=message):
        fitted(dataclasses.replace(VIEW, **change))


def test_no_rows_are_refused() -> None:
    with pytest.raises(DataError, match="got 0 rows"):
        fitted(VIEW.rows(slice(0, 0)))


@pytest.mark.parametrize("rows", [1, 2, 3, 7, 30])
def test_few_rows_give_a_policy_all_the_same(rows: int) -> None:
    forest = fitted(VIEW.rows(slice(0, rows)))

    action = forest.act(VIEW.feature_row(0), "task 0")

    assert np.isfinite(action.targets).all()
    assert 0.0 <= action.confidence <= 1.0


def test_a_memory_mapped_view_gives_the_same_policy(tmp_path) -> None:
    path = tmp_path / "features.npy"
    np.save(path, VIEW.features)
    mapped = dataclasses.replace(VIEW, features=np.load(path, mmap_mode="r"))

    a, b = fitted(), fitted(mapped)

    row = VIEW.feature_row(5)
    np.testing.assert_array_equal(a.act(row, "task 1").targets, b.act(row, "task 1").targets)


def test_the_threads_of_a_fit_are_not_in_the_file() -> None:
    assert "threads" not in fitted(threads=2).model.config


def test_fitting_imports_no_scikit_learn() -> None:
    import subprocess
    import sys

    code = (
        "import sys, numpy as np\n"
        "from clothrf_core.testing.policy import synthetic_view\n"
        "from clothrf_forest.config import ForestConfig\n"
        "from clothrf_forest.policy import Forest\n"
        "Forest(ForestConfig(trees=2)).fit(synthetic_view(), np.random.default_rng(0))\n"
        "assert not any(name.split('.')[0] == 'sklearn' for name in sys.modules)\n"
    )

    subprocess.run([sys.executable, "-c", code], check=True)
