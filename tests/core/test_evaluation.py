import numpy as np

from clothrf_core.evaluation import EpisodeJob, confidence_curve, error_numbers, interval


def test_error_is_per_coordinate(rng):
    labels = rng.normal(size=(500, 1, 2, 3))
    numbers = error_numbers(labels, labels + 0.01)
    assert np.isclose(numbers["rms_mm"], 10.0)
    assert np.isclose(numbers["mse_m2"], 1e-4)


def test_predicting_the_mean_scores_one(rng):
    labels = rng.normal(size=(500, 1, 2, 3))
    mean = np.broadcast_to(labels.mean(axis=0), labels.shape)
    assert np.isclose(error_numbers(labels, mean)["nre"], 1.0)


def test_the_interval_covers_the_mean_in_95_of_100_draws(rng):
    inside = 0
    for _ in range(2000):
        mean, half = interval(rng.normal(3.0, 1.0, size=10))
        inside += abs(mean - 3.0) <= half
    assert 0.935 < inside / 2000 < 0.965


def test_the_confidence_curve_finds_the_error_of_each_bin():
    labels = np.zeros((100, 1, 2, 3))
    confidence = np.where(np.arange(100) < 50, 0.15, 0.95)[:, None]
    targets = np.where(np.arange(100)[:, None, None, None] < 50, 0.03, 0.01) + labels
    curve = confidence_curve(labels, targets, confidence)
    assert np.allclose(curve, [[0.15, 30.0, 50], [0.95, 10.0, 50]])


def test_a_sequence_asks_for_its_tasks_in_turn():
    job = EpisodeJob("", "", "straight", 0, 0, 1, 10, then=("bent", "twisted"), every_s=2.0)
    asked = [job.task_at(step / 30.0) for step in (0, 59, 60, 119, 120, 180)]
    assert asked == ["straight", "straight", "bent", "bent", "twisted", "straight"]
