from __future__ import annotations

import numpy as np
import pytest
from clothrf_forest.config import LabelsConfig
from clothrf_forest.labels import k_means, label_actions, mean_shift, nearest
from sklearn.cluster import MeanShift


def blobs(seed: int = 0, centres: int = 9, n: int = 600, d: int = 6, spread: float = 0.01):
    rng = np.random.default_rng(seed)
    middle = rng.uniform(-0.3, 0.3, (centres, d))
    member = rng.integers(centres, size=n)
    return middle[member] + spread * rng.normal(size=(n, d)), member


@pytest.mark.parametrize("seed", range(3))
def test_mean_shift_finds_the_modes_that_scikit_learn_finds(seed: int) -> None:
    points, _ = blobs(seed, spread=0.02)

    ours = mean_shift(points, 0.1)
    oracle = MeanShift(bandwidth=0.1, bin_seeding=True).fit(points).cluster_centers_

    assert len(ours) == len(oracle)
    distance = np.linalg.norm(ours[:, None] - oracle, axis=2)
    assert distance.min(axis=1).max() < 0.01


def test_separate_blobs_get_separate_labels() -> None:
    points, member = blobs()

    index = nearest(points, mean_shift(points, 0.1))

    pairs = {(int(a), int(b)) for a, b in zip(index, member, strict=True)}
    assert len(pairs) == len(np.unique(member)) == len(np.unique(index))


def test_small_clusters_join_the_nearest_larger_one() -> None:
    points, _ = blobs(centres=3)
    stray = np.full((2, 6), 5.0)

    centres = mean_shift(np.concatenate([points, stray]), 0.1, min_points=5)

    assert np.abs(centres).max() < 1.0
    assert len(centres) == 3


def test_the_bandwidth_is_halved_until_there_are_enough_labels(caplog) -> None:
    points = np.random.default_rng(0).uniform(-0.1, 0.1, (1000, 3))
    config = LabelsConfig(bandwidth=0.4, minimum=20)

    with caplog.at_level("INFO"):
        labels = label_actions(points, config, np.random.default_rng(0))

    assert len(labels.centres) >= 20
    assert labels.bandwidth < 0.4
    assert caplog.messages == [
        f"mean shift: 0.4 m gives fewer than 20 labels; {labels.bandwidth:g} m gives "
        f"{len(labels.centres)}"
    ]


def test_a_wide_kernel_alone_would_give_one_label() -> None:
    points = np.random.default_rng(0).uniform(-0.1, 0.1, (500, 6))

    assert len(mean_shift(points, 0.5)) == 1


def test_all_rows_are_labelled_although_centres_are_sought_among_some() -> None:
    points, _ = blobs(n=3000)

    labels = label_actions(points, LabelsConfig(sample=200), np.random.default_rng(0))

    assert labels.index.shape == (3000,)
    np.testing.assert_array_equal(labels.index, nearest(points, labels.centres))


def test_k_means_reaches_a_fixed_point_that_covers_the_points() -> None:
    points, _ = blobs()

    centres = k_means(points, 9, np.random.default_rng(0), rounds=100)

    index = nearest(points, centres)
    for k in range(9):
        np.testing.assert_allclose(points[index == k].mean(axis=0), centres[k], atol=1e-12)


def test_k_means_has_a_label_for_every_thirty_rows() -> None:
    points = np.random.default_rng(0).normal(size=(1200, 6))

    labels = label_actions(points, LabelsConfig(method="k-means"), np.random.default_rng(0))

    assert len(labels.centres) == 40
    assert labels.bandwidth == 0.0


def test_equal_actions_get_one_label_and_no_crash() -> None:
    labels = label_actions(np.ones((50, 6)), LabelsConfig(), np.random.default_rng(0))

    assert set(labels.index) == {0}


def test_where_no_clusters_are_large_enough_k_means_makes_labels_that_are() -> None:
    points = np.random.default_rng(0).uniform(-1.0, 1.0, (240, 18))

    labels = label_actions(points, LabelsConfig(), np.random.default_rng(0))

    assert labels.bandwidth == 0.0
    assert len(labels.centres) == 20
