from __future__ import annotations

import numpy as np
import pytest
from clothrf_how.histogram import median_bin


def test_the_median_of_counted_numbers_is_theirs_to_a_bin():
    numbers = np.random.default_rng(0).gamma(3.0, 5.0, 999)
    count = np.bincount(numbers.astype(int), minlength=100)

    assert median_bin(count, len(numbers)) == pytest.approx(np.median(numbers), abs=1.0)


def test_too_few_counted_numbers_have_their_median_beyond_the_last_bin():
    assert median_bin(np.array([1, 0, 1]), 9) == 3.0
