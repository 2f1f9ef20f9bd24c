from __future__ import annotations

import numpy as np
from clothrf_forest.config import ForestConfig
from clothrf_forest.curves import REACH, Curved, fit_curves, no_curves, products
from clothrf_forest.foundation import lay
from clothrf_forest.ridge import Straight, spread
from clothrf_forest.rows import Rows


def bowl(n: int = 1200):
    rng = np.random.default_rng(0)
    x = rng.normal(size=(n, 6)).astype(np.float32)
    y = np.stack([x[:, 0] * x[:, 1], x[:, 0] ** 2 + x[:, 2]], axis=1).astype(np.float64)
    return Rows(x), y, np.arange(n) // 20


def straight(rows: Rows) -> Straight:
    return Straight(rows, spread(lambda part: rows[part], len(rows), rows.width))


def test_products_are_those_of_all_pairs_once() -> None:
    u = np.array([[1.0, 2.0, 3.0]])

    assert products(u).tolist() == [[1.0, 2.0, 3.0, 4.0, 6.0, 9.0]]


def test_a_wild_direction_is_clipped_before_it_is_squared() -> None:
    assert products(np.array([[1e9]])).tolist() == [[REACH**2]]


def test_no_curves_add_nothing() -> None:
    rows, _, _ = bowl(50)

    design = Curved(straight(rows), no_curves(rows.width))

    assert design.of(slice(0, 7)).shape == (7, design.width) == (7, rows.width)


def test_products_are_standardised_on_the_rows_they_were_fitted_on() -> None:
    rows, _, _ = bowl()
    design = straight(rows)

    found = fit_curves(design, np.eye(6)[:, :3]).of(design.of(slice(None)))

    assert found.shape == (1200, 6)
    # The few that are clipped keep it from being exact.
    np.testing.assert_allclose(found.mean(0), 0.0, atol=0.05)
    np.testing.assert_allclose(found.std(0), 1.0, atol=0.15)


def test_a_quadratic_base_leaves_little_of_a_bowl_and_a_linear_one_most() -> None:
    rows, y, groups = bowl()

    def left(base: str) -> float:
        config = ForestConfig.model_validate({"base": base})
        return float(lay(rows, y, groups, config, np.random.default_rng(0)).residual.std())

    assert left("quadratic") < 0.25 * left("ridge")
