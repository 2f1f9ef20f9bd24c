from __future__ import annotations

import numpy as np
from clothrf_forest.config import ForestConfig
from clothrf_forest.curves import trusted
from clothrf_forest.foundation import lay
from clothrf_forest.ridge import Straight, correlations, fold_of, spread, survey
from clothrf_forest.rows import Rows
from clothrf_forest.telling import telling


def bent_along(direction: np.ndarray, n: int = 900):
    rng = np.random.default_rng(0)
    x = rng.normal(size=(n, len(direction))).astype(np.float32)
    x[:, -2:] *= 8.0  # what varies most says nothing
    y = np.stack([(x @ direction) ** 2 + x @ direction, 2.0 * (x @ direction)], axis=1)
    return Rows(x), y.astype(np.float64), np.arange(n) // 30


def told(rows: Rows, y: np.ndarray, groups: np.ndarray, most: int):
    design = Straight(rows, spread(lambda part: rows[part], len(rows), rows.width))
    known = survey(design, y, fold_of(groups, 6, np.random.default_rng(0)))
    weight = correlations(known.whole())
    everywhere = np.arange(len(rows))
    return telling(design, y, weight, most, everywhere, np.random.default_rng(1))


def test_the_most_telling_direction_is_the_one_that_answers_depend_on() -> None:
    direction = np.array([0.6, -0.8, 0.0, 0.0, 0.0, 0.0])

    found = told(*bent_along(direction), most=3)

    first = found.axes[:, 0] / np.linalg.norm(found.axes[:, 0])
    assert abs(first @ direction) > 0.98
    assert found.reach[0] == 1.0
    assert found.reach[1] < 0.5


def test_there_are_no_more_directions_than_features() -> None:
    found = told(*bent_along(np.eye(4)[0]), most=48)

    assert found.axes.shape == (4, 4)
    assert (np.diff(found.reach) <= 1e-12).all()


def test_products_of_dull_directions_are_trusted_little() -> None:
    found = trusted(np.ones(3), np.array([1.0, 0.1]))

    np.testing.assert_allclose(found[3:] / found[3], [1.0, 0.1, 0.01])
    assert np.isclose((found**2).mean(), 1.0)


def test_labels_of_held_out_roll_outs_choose_nothing_that_judges_them() -> None:
    rng = np.random.default_rng(3)
    rows = Rows(rng.normal(size=(600, 60)).astype(np.float32))
    noise = rng.normal(size=(600, 2))
    config = ForestConfig(curve_directions=20)

    found = lay(rows, noise, np.arange(600) // 20, config, np.random.default_rng(0))

    # Directions chosen on all labels would make noise look foreseeable.
    assert (found.residual**2).mean() > 0.98 * noise.var()


def test_the_foundation_is_the_same_for_any_number_of_threads() -> None:
    rows, y, groups = bent_along(np.eye(6)[0])

    one, two = (
        lay(rows, y, groups, ForestConfig(), np.random.default_rng(0), threads=n) for n in (1, 2)
    )

    assert np.array_equal(one.residual, two.residual)
    assert np.array_equal(one.curves.axes, two.curves.axes)
