from __future__ import annotations

import numpy as np
import pytest
from clothrf_forest.ridge import (
    LIMIT,
    Scaling,
    Straight,
    fit_base,
    fold_by_fold,
    fold_of,
    solve,
    spread,
    squared_error,
    survey,
)
from clothrf_forest.rows import Rows
from sklearn.linear_model import Ridge


def linear_rows(n: int = 900, noise: float = 0.1):
    rng = np.random.default_rng(0)
    x = rng.normal(size=(n, 12)).astype(np.float32) * np.linspace(0.1, 5.0, 12, dtype=np.float32)
    x[:, 5] = 3.0
    y = x[:, :3] @ rng.normal(size=(3, 4)) + 2.0 + noise * rng.normal(size=(n, 4))
    groups = np.arange(n) // 30
    return Rows(x), y, groups


def surveyed(rows: Rows, y, groups):
    by = spread(lambda part: rows[part], len(rows), rows.width)
    return survey(Straight(rows, by), y, fold_of(groups, 6, np.random.default_rng(0)))


def test_a_wild_value_counts_as_five_standard_deviations() -> None:
    by = Scaling(np.zeros(2, np.float32), np.full(2, 10.0, np.float32))

    assert by.of(np.array([[1e6, -0.1]], np.float32)).tolist() == [[LIMIT, -1.0]]


def test_folds_hold_whole_roll_outs_of_equal_number() -> None:
    groups = np.repeat(np.arange(30), 7)

    fold = fold_of(groups, 6, np.random.default_rng(0))

    assert all(len(set(fold[groups == g])) == 1 for g in range(30))
    assert set(np.bincount(fold)) == {35}


def test_moments_in_folds_add_up_to_those_of_all_rows() -> None:
    rows, y, groups = linear_rows()
    known = surveyed(rows, y, groups)
    x = known.design.of(slice(None))

    whole = known.whole()

    np.testing.assert_allclose(whole.xx, x.T @ x, rtol=1e-9, atol=1e-6)
    np.testing.assert_allclose(whole.xy, x.T @ y, rtol=1e-9, atol=1e-6)
    assert whole.n == len(rows)


def test_it_is_ridge_regression_on_features_scaled_by_their_correlation() -> None:
    rows, y, groups = linear_rows()
    known = surveyed(rows, y, groups)
    x = known.design.of(slice(None))
    cross = (x - x.mean(0)).T @ (y - y.mean(0)) / len(x)
    weight = np.sqrt((cross**2).sum(1) / np.maximum(x.var(0), 1e-12))
    weight /= np.sqrt((weight**2).mean())

    ours = solve(known.whole(), 0.1)
    theirs = Ridge(alpha=0.1 * len(x)).fit(x * weight, y)

    np.testing.assert_allclose(
        x @ ours.coef + ours.intercept, theirs.predict(x * weight), atol=1e-8
    )


def test_errors_from_moments_are_those_of_the_predictions() -> None:
    rows, y, groups = linear_rows()
    known = surveyed(rows, y, groups)
    x = known.design.of(slice(None))
    model = solve(known.parts[0], 0.1)

    found = squared_error(known.parts[1], model)

    mine = known.fold == 1
    wanted = ((x[mine] @ model.coef + model.intercept - y[mine]) ** 2).sum()
    assert found == pytest.approx(wanted, rel=1e-9)


def test_held_out_predictions_never_saw_their_roll_out() -> None:
    rows, y, groups = linear_rows()
    first = surveyed(rows, y, groups)
    mine = first.fold == 2
    other = y.copy()
    other[mine] += 100.0

    a = fit_base(y, first, fold_by_fold(first))
    second = survey(first.design, other, first.fold)
    b = fit_base(other, second, fold_by_fold(second))

    if a.strength == b.strength:
        np.testing.assert_allclose(a.held_out[mine], b.held_out[mine])
    assert not np.allclose(a.held_out[~mine], b.held_out[~mine])


def test_what_is_linear_is_found() -> None:
    rows, y, groups = linear_rows(noise=0.01)
    known = surveyed(rows, y, groups)

    base = fit_base(y, known, fold_by_fold(known))

    assert np.sqrt(((base.held_out - y) ** 2).mean()) < 0.015


def test_pure_noise_is_shrunk_to_nearly_a_constant() -> None:
    rows, _, groups = linear_rows(200)
    noise = np.random.default_rng(1).normal(size=(200, 4))
    known = surveyed(rows, noise, groups)

    base = fit_base(noise, known, fold_by_fold(known))

    assert ((base.held_out - noise) ** 2).mean() < 1.1 * noise.var()
