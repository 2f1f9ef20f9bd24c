from __future__ import annotations

import math

import cv2
import numpy as np
import pytest
from clothrf_how.config import HowOptions
from clothrf_how.gabor import bank, factors, gabor


@pytest.mark.parametrize("theta", [0.0, math.pi / 4, math.pi / 2, 2.0])
def test_the_kernel_is_opencvs(theta):
    ours = gabor(theta, sigma=6.0, wavelength=10.0, gamma=0.5, psi=0.0, size=101)

    theirs = cv2.getGaborKernel(
        ksize=(101, 101), sigma=6.0, theta=theta, lambd=10.0, gamma=0.5, psi=0.0
    )

    np.testing.assert_allclose(ours, theirs, atol=1e-12)


def test_the_published_kernel_leaks_a_constant_and_ours_does_not():
    paper = HowOptions(sigma=6, wavelength=10, kernel_size=101, zero_mean=False, unit_norm=False)
    ours = HowOptions(sigma=6, wavelength=10, kernel_size=101)

    (leaking,) = bank(paper, orientations=1, wavelength=10.0, psi=0.0)
    (still,) = bank(ours, orientations=1, wavelength=10.0, psi=0.0)

    assert leaking.sum() == pytest.approx(0.371, abs=2e-3)
    assert np.linalg.norm(leaking) == pytest.approx(10.63, abs=0.01)
    assert abs(float(still.sum(dtype=np.float64))) < 1e-5
    assert np.linalg.norm(still) == pytest.approx(1.0, abs=1e-6)


@pytest.mark.parametrize("psi", [0.0, math.pi / 2])
def test_the_separable_kernels_are_the_square_ones_but_for_their_ends(psi):
    options = HowOptions()
    square = bank(options, orientations=4, wavelength=options.wavelength, psi=psi)

    for separable, whole in zip(factors(options, psi=psi), square, strict=True):
        kernel = separable.kernel()
        size = max(len(kernel), len(whole))
        a = np.pad(kernel, (size - len(kernel)) // 2)
        b = np.pad(whole, (size - len(whole)) // 2)
        # The corners of the square, and what lies 3.5 sigma across, are what differs.
        assert np.linalg.norm(a - b) < 0.07
        assert abs(kernel.sum()) < 1e-12
        assert np.linalg.norm(kernel) == pytest.approx(1.0, abs=1e-12)


def test_each_separable_kernel_answers_best_to_its_own_stripes():
    options = HowOptions()
    y, x = np.mgrid[-30:31, -30:31]
    answers = np.zeros((4, 4))
    for i in range(4):
        theta = i * math.pi / 4
        stripes = np.cos(
            2 * math.pi * (x * math.cos(theta) + y * math.sin(theta)) / options.wavelength
        )
        for j, factor in enumerate(factors(options, psi=0.0)):
            kernel = factor.kernel()
            m = len(kernel) // 2
            answers[i, j] = (stripes[30 - m : 31 + m, 30 - m : 31 + m] * kernel).sum()

    assert (answers.argmax(axis=1) == np.arange(4)).all()
