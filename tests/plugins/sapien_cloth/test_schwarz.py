from __future__ import annotations

import numpy as np
import pytest
from clothrf_sapien import schwarz
from clothrf_sapien.coarse import collapse, transpose
from clothrf_sapien.schwarz import direction, plan, precondition
from clothrf_sapien.stencil import hold, multiply

from .sheets import whole

WIDE = (37, schwarz.WIDEST + 1)


def positive(rng, rows, columns, *, pins=()):
    """A matrix of springs between neighbours that pull each its own way, and something to hold."""
    num = rows * columns
    r, c = np.divmod(np.arange(num), columns)
    matrix = np.zeros((5, 6, num))
    matrix[0, [0, 3, 5]] = 0.05
    upper = np.triu_indices(3)
    for s, offset, exists in (
        (1, 1, c + 1 < columns),
        (2, columns, r + 1 < rows),
        (3, columns + 1, (r + 1 < rows) & (c + 1 < columns)),
        (4, columns - 1, (r + 1 < rows) & (c > 0)),
    ):
        for a in np.flatnonzero(exists):
            d = rng.normal(size=3)
            block = np.outer(d, d)[upper]
            matrix[s, :, a] = -block
            matrix[0, :, a] += block
            matrix[0, :, a + offset] += block
    second = np.where(c + 2 < columns, 0.01, 0.0)
    pins = np.asarray(pins, np.int64)
    hold(matrix, pins, columns)
    second[pins] = 0.0
    second[pins[pins >= 2] - 2] = 0.0
    return matrix, second


def interpolation(shares):
    P = np.zeros((len(shares), int(shares[:, 0].max()) + 2))
    for i, (k, share) in enumerate(shares):
        P[i, int(k) : int(k) + 2] = 1 - share, share
    return P


def test_the_product_equals_the_dense_one() -> None:
    rng = np.random.default_rng(1)
    matrix, second = positive(rng, 5, 7)
    x, out = rng.normal(size=(3, 35)), np.full((3, 35), 7.0)

    multiply(matrix, second, 7, x, out)

    assert np.allclose(out.T.ravel(), whole(matrix, second, 7) @ x.T.ravel(), rtol=0, atol=1e-12)


@pytest.mark.parametrize("rows", [5, 6, 9])
def test_the_coarse_matrix_is_the_fine_one_between_interpolated_rows(rows) -> None:
    rng = np.random.default_rng(2)
    matrix, second = positive(rng, rows, 5)
    shares = schwarz.plan(rows, 5).row
    P = np.kron(interpolation(shares), np.eye(15))
    out = np.full((5, 6, P.shape[1] // 3), 7.0)
    none = np.zeros(P.shape[1] // 3)

    collapse(matrix, second[:0], 5, shares, out)

    truth = P.T @ whole(matrix, 0 * second, 5) @ P
    assert np.allclose(whole(out, none, 5), truth, rtol=0, atol=1e-12 * np.abs(truth).max())

    collapse(matrix, second, 5, shares, out)
    surplus = whole(out, none, 5) - P.T @ whole(matrix, second, 5) @ P
    assert np.linalg.eigvalsh(surplus).min() > -1e-12


def test_a_transposed_matrix_is_the_same_with_vertices_renumbered() -> None:
    rng = np.random.default_rng(3)
    matrix, _ = positive(rng, 4, 6)
    out, none = np.full_like(matrix, 7.0), np.zeros(24)

    transpose(matrix, 6, out)

    order = (3 * np.arange(24).reshape(4, 6).T.ravel()[:, None] + np.arange(3)).ravel()
    assert np.array_equal(whole(out, none, 4), whole(matrix, none, 6)[np.ix_(order, order)])


def test_a_narrow_grid_is_solved_to_single_precision_by_one_band() -> None:
    rng = np.random.default_rng(4)
    pins = np.array([0, 5, 30])
    matrix, second = positive(rng, 9, 6, pins=pins)
    g, p = rng.normal(size=(3, 54)), np.empty((3, 54))
    g[:, pins] = 0.0

    assert direction(matrix, second, g, pins, plan(9, 6), p) == 0

    truth = np.linalg.solve(whole(matrix, second, 6), -g.T.ravel())
    assert np.abs(p.T.ravel() - truth).max() < 1e-5 * np.abs(truth).max()


def test_strips_and_a_coarse_grid_solve_a_wide_one_in_a_few_steps() -> None:
    rng = np.random.default_rng(5)
    rows, columns = WIDE
    num = rows * columns
    pins = np.array([0, columns - 1, num - columns, num - 1])
    matrix, second = positive(rng, rows, columns, pins=pins)
    g, p = rng.normal(size=(3, num)), np.empty((3, num))
    g[:, pins] = 0.0

    steps = direction(matrix, second, g, pins, plan(rows, columns), p)

    H = whole(matrix, second, columns)
    truth = np.linalg.solve(H, -g.T.ravel())
    error = p.T.ravel() - truth
    assert 0 < steps <= 12
    assert error @ H @ error < (3 * schwarz.TOLERANCE) ** 2 * (truth @ H @ truth)
    assert not p[:, pins].any()


def test_the_approximate_inverse_is_symmetric_and_positive() -> None:
    rng = np.random.default_rng(6)
    rows, columns = WIDE
    num = rows * columns
    pins = np.array([0, num - 1])
    matrix, second = positive(rng, rows, columns, pins=pins)
    how = plan(rows, columns)
    x, y, p = rng.normal(size=(3, num)), rng.normal(size=(3, num)), np.empty((3, num))
    x[:, pins] = y[:, pins] = 0.0
    direction(matrix, second, x, pins, how, p)

    u, v = np.empty_like(x), np.empty_like(y)
    precondition(x, pins, how, u)
    precondition(y, pins, how, v)

    assert (u * y).sum() == pytest.approx((v * x).sum(), rel=1e-3)
    assert (u * x).sum() > 0.0


def test_the_strips_cover_a_wide_grid_and_overlap_their_neighbours() -> None:
    how = plan(60, 50)

    begins, ends = how.strips[:-1, 0], how.strips[:-1, :2].sum(axis=1)
    assert begins[0] == 0
    assert ends[-1] == 50
    assert np.array_equal(ends[:-1] - begins[1:], np.full(len(ends) - 1, 2))
    assert how.bands.ctypes.data % 64 == 0
