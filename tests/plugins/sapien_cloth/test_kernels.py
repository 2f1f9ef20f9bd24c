from __future__ import annotations

import numpy as np
import pytest
from clothrf_sapien.banded import band_shape, factor, solve
from clothrf_sapien.elements import bend, constant_part, evaluate, measure
from clothrf_sapien.elements import hessian as compiled_hessian
from clothrf_sapien.stencil import VERTICES, fill
from scipy.linalg import solveh_banded

from .sheets import (
    bending_matrix,
    crumpled,
    dense,
    energy,
    hessian,
    past,
    sheet,
    spring_lengths,
    whole,
    woven,
)

RESOLUTIONS = [(2, 2), (2, 5), (3, 4), (5, 6), (9, 4)]
NOTHING = np.zeros(0, np.int64)


def evaluated(w, x, before, pins=NOTHING):
    """Energy, (V, 3) gradient and the Hessian's two parts, from the kernels."""
    num = len(w.mass)
    g, springs, work = np.empty((3, num)), np.zeros((4, 5, num)), np.empty((4, num))
    matrix, constant = np.full((5, 6, num), 7.0), np.empty((6, num))
    s = sheet(w, pins)
    value = evaluate(np.ascontiguousarray(x.T), s, before, g, springs, work)
    constant_part(s, before.h, constant)
    compiled_hessian(springs, s, before, constant, work, matrix)
    return value, g.T, (matrix, constant[5])


def assembled(w, parts, first=0, width=0):
    """The band of a strip as a dense matrix."""
    matrix, second = parts
    width = width or w.columns
    num = w.rows * width
    columns, S = band_shape(3 * num, 3 * (max(width, 2) + 1) + 2)
    A = np.full(columns * S, 7.0, np.float32)
    for group in range(columns // (3 * VERTICES)):
        fill(A, S, matrix, second, w.columns, first, width, group)
    return dense(A, columns, S, 3 * num)


@pytest.mark.parametrize("resolution", RESOLUTIONS)
@pytest.mark.parametrize("stretch", [0.9, 1.05])
def test_the_compiled_energy_equals_its_numpy_twin(resolution, stretch) -> None:
    rng = np.random.default_rng(1)
    w = woven(resolution)
    x, before = crumpled(w, rng, stretch=stretch), past(w, rng)

    assert evaluated(w, x, before)[0] == pytest.approx(energy(x, w, before), rel=1e-12)


@pytest.mark.parametrize("resolution", RESOLUTIONS)
@pytest.mark.parametrize("stretch", [0.9, 1.05])
def test_the_gradient_is_the_energy_s_by_finite_differences(resolution, stretch) -> None:
    rng = np.random.default_rng(2)
    w = woven(resolution)
    x, before = crumpled(w, rng, stretch=stretch), past(w, rng)
    g = evaluated(w, x, before)[1]

    step = 1e-7
    numeric = np.zeros_like(x)
    for index in np.ndindex(*x.shape):
        ahead, behind = x.copy(), x.copy()
        ahead[index] += step
        behind[index] -= step
        numeric[index] = (energy(ahead, w, before) - energy(behind, w, before)) / (2 * step)

    assert np.abs(g - numeric).max() < 1e-6 * np.abs(g).max()


@pytest.mark.parametrize("resolution", RESOLUTIONS)
def test_the_band_holds_the_projected_hessian(resolution) -> None:
    rng = np.random.default_rng(3)
    w = woven(resolution)
    x, before = crumpled(w, rng), past(w, rng)
    parts = evaluated(w, x, before)[2]

    H = hessian(x, w, before)
    assert np.abs(whole(*parts, w.columns) - H).max() < 1e-12 * np.abs(H).max()
    assert np.abs(assembled(w, parts) - H).max() < 3e-7 * np.abs(H).max()


def test_the_band_of_a_strip_is_what_remains_when_all_other_vertices_are_held() -> None:
    rng = np.random.default_rng(11)
    w = woven((6, 7))
    parts = evaluated(w, crumpled(w, rng), past(w, rng))[2]

    H = whole(*parts, w.columns)
    column = np.repeat(np.arange(len(w.mass)) % w.columns, 3)
    kept = (column >= 2) & (column < 5)
    strip = assembled(w, parts, first=2, width=3)
    assert np.abs(strip - H[np.ix_(kept, kept)]).max() < 3e-7 * np.abs(H).max()


def test_under_tension_the_hessian_is_the_gradient_s_by_finite_differences() -> None:
    rng = np.random.default_rng(4)
    w = woven(fabric=replace_bending(0.0))
    x, before = crumpled(w, rng, stretch=1.5), past(w, rng)
    H = hessian(x, w, before)

    step = 1e-6
    direction = rng.normal(size=x.shape)
    ahead = evaluated(w, x + step * direction, before)[1]
    behind = evaluated(w, x - step * direction, before)[1]

    numeric = (ahead - behind) / (2 * step)
    assert np.abs(H @ direction.ravel() - numeric.ravel()).max() < 1e-6 * np.abs(numeric).max()


def test_what_the_band_leaves_out_of_bending_only_adds_to_the_model() -> None:
    rng = np.random.default_rng(5)
    w = woven((4, 7))
    x, before = crumpled(w, rng), past(w, rng)

    exact = np.kron(bending_matrix(w) * (1 + w.numbers[0] / before.h), np.eye(3))
    springs_only = hessian(x, woven((4, 7), fabric=replace_bending(0.0)), before)
    surplus = hessian(x, w, before) - springs_only - exact

    assert np.linalg.eigvalsh(surplus).min() > -1e-9
    assert np.linalg.eigvalsh(surplus).max() > 1e-3


def test_the_hessian_is_positive_definite_even_when_everything_is_compressed() -> None:
    rng = np.random.default_rng(6)
    w = woven()
    x, before = crumpled(w, rng, stretch=0.3), past(w, rng)

    assert np.linalg.eigvalsh(hessian(x, w, before)).min() > 0


def test_pinned_vertices_are_no_unknowns() -> None:
    rng = np.random.default_rng(7)
    w = woven((4, 5))
    pins = np.array([0, 3, 10])
    x, before = crumpled(w, rng), past(w, rng)
    _, g, parts = evaluated(w, x, before, pins)

    H = assembled(w, parts)
    rows = (3 * pins[:, None] + np.arange(3)).ravel()
    assert not g[pins].any()
    assert np.array_equal(H[rows], np.eye(len(H))[rows])


def test_bending_and_lengths_equal_their_numpy_twins() -> None:
    rng = np.random.default_rng(8)
    w = woven((6, 7))
    x = crumpled(w, rng)
    rows, bent = np.ascontiguousarray(x.T), np.empty((3, len(x)))
    lengths = np.zeros_like(w.springs)

    bend(rows, sheet(w, NOTHING), bent, np.empty(len(x)))
    measure(rows, sheet(w, NOTHING), lengths)
    lengths[w.springs == 0] = 0.0

    assert np.allclose(bent.T, bending_matrix(w) @ x, rtol=0, atol=1e-12 * np.abs(x).max())
    assert np.allclose(lengths, spring_lengths(w, x), rtol=1e-14)


def test_bending_does_not_resist_rigid_motion_or_shear_of_the_flat_sheet() -> None:
    w = woven((5, 7))
    flat = np.concatenate([w.mesh.rest, np.ones((len(w.mass), 1))], axis=1)
    affine = flat @ np.random.default_rng(9).normal(size=(3, 3))

    assert np.abs(bending_matrix(w) @ affine).max() < 1e-12


@pytest.mark.parametrize(("size", "half_width"), [(1, 0), (8, 3), (30, 8), (63, 24), (300, 68)])
def test_the_banded_solver_agrees_with_scipy_in_double_precision(size, half_width) -> None:
    rng = np.random.default_rng(10)
    half_width = min(half_width, size - 1)
    band = rng.normal(scale=0.3, size=(half_width + 1, size))
    band[0] = 2.0 + half_width
    right = rng.normal(size=size)
    columns, S = band_shape(size, half_width)
    A, x = np.zeros(columns * S, np.float32), np.zeros(columns, np.float32)
    for j in range(columns):
        count = min(half_width + 1, size - j)
        A[j * S + j % 8 :][: max(count, 1)] = band[:count, j] if j < size else 1.0
    x[:size] = right

    factor(A, 0, columns // 8, columns, S)
    solve(A, columns, S, x)

    truth = solveh_banded(band, right, lower=True)
    assert np.abs(x[:size] - truth).max() < 1e-5 * np.abs(truth).max()
    assert not x[size:].any()


def test_a_pivot_lost_to_round_off_freezes_its_unknown_and_nothing_else() -> None:
    columns, S = band_shape(24, 2)
    A, x = np.zeros(columns * S, np.float32), np.ones(columns, np.float32)
    A[np.arange(columns) * S + np.arange(columns) % 8] = 4.0
    A[3 * S + 3] = -1.0

    factor(A, 0, columns // 8, columns, S)
    solve(A, columns, S, x)

    assert x[3] == pytest.approx(0.0, abs=1e-6)
    assert np.allclose(np.delete(x, 3), 0.25)


def replace_bending(bending: float):
    from dataclasses import replace

    from .sheets import FABRIC

    return replace(FABRIC, bending=bending)
