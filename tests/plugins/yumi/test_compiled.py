"""The compiled loops against plain numpy."""

from __future__ import annotations

import numpy as np
import pytest

pytest.importorskip("numba")

from clothrf_yumi.compiled import NEW, SAME, recall, settle


@pytest.mark.parametrize("seed", range(5))
def test_the_nearest_memory_is_loosened_by_what_the_joints_turned(seed):
    rng = np.random.default_rng(seed)
    bounds, postures = rng.uniform(0, 1, (2, 30)), rng.normal(0, 1, (2, 14))
    levers, q = rng.uniform(0, 1, (14, 30)), rng.normal(0, 1, 14)
    nearest = int(np.abs(q - postures).max(axis=1).argmin())
    wanted, places = bounds.copy(), postures.copy()
    wanted[nearest] -= np.abs(q - postures[nearest]) @ levers
    places[nearest] = q

    assert recall(bounds, postures, levers, q) == nearest
    np.testing.assert_allclose(bounds, wanted, rtol=0, atol=1e-12)
    np.testing.assert_array_equal(postures, places)


def test_a_target_is_clamped_and_its_change_is_seen():
    low, high, wanted = -np.ones(14), np.ones(14), np.zeros(14)
    target = np.linspace(-2.0, 2.0, 14)

    assert settle(target, low, high, wanted) == NEW
    np.testing.assert_array_equal(wanted, np.clip(target, low, high))
    assert settle(target * 1.0, low, high, wanted) == SAME


@pytest.mark.parametrize("bad", [np.nan, np.inf, -np.inf])
def test_a_joint_that_is_not_finite_is_named_and_nothing_is_changed(bad):
    target, wanted = np.ones(14), np.zeros(14)
    target[5] = bad

    assert settle(target, -np.ones(14), np.ones(14), wanted) == 5
    assert not wanted.any()
