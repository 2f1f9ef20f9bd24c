from __future__ import annotations

import numpy as np
import pytest
from clothrf_forest.novelty import fit_novelty, limited, relative, usual
from clothrf_forest.ridge import Straight, fold_of, spread, survey
from clothrf_forest.rows import Rows


def known(x: np.ndarray):
    rows = Rows(x.astype(np.float32))
    design = Straight(rows, spread(lambda part: rows[part], len(rows), rows.width))
    fold = fold_of(np.arange(len(x)) // 20, 6, np.random.default_rng(0))
    return survey(design, np.zeros((len(x), 1)), fold)


def flat(n: int = 1200) -> np.ndarray:
    """Rows near a plane of 3 dimensions in 12."""
    rng = np.random.default_rng(0)
    return rng.normal(size=(n, 3)) @ rng.normal(size=(3, 12)) + 0.05 * rng.normal(size=(n, 12))


def test_known_rows_score_about_one_and_what_leaves_their_plane_scores_more() -> None:
    survey_of = known(flat())

    model, scores, apart = fit_novelty(survey_of, components=3)

    assert apart
    assert 0.3 < np.median(scores) < 1.3
    away = survey_of.design.of(slice(0, 50)).copy()
    away[:, 0] += 2.0
    assert model.scores(away).min() > scores.max()


def test_a_rare_pose_that_is_known_looks_less_strange_than_by_a_plain_gaussian() -> None:
    x = flat()
    rng = np.random.default_rng(1)
    rare = np.arange(len(x)) % 40 == 0
    x[rare] += np.outer(rng.normal(size=rare.sum()), np.linspace(-1.0, 1.0, 12))
    of = known(x)
    plain = 0
    for half in (0, 1):
        other = np.cov(of.design.of(slice(None))[of.fold % 2 != half].T)
        value, axes = np.linalg.eigh(other)
        value[:-4] = value[:-4].mean()
        z = of.design.of(slice(None))[rare & (of.fold % 2 == half)]
        plain += ((z @ axes) ** 2 / value).sum()

    _, scores, _ = fit_novelty(of, components=4)

    assert scores[rare].sum() < plain / 12


def test_too_few_rows_are_not_judged_apart() -> None:
    assert not fit_novelty(known(flat(60)), components=40)[2]


def test_leaves_are_used_to_the_scores_of_their_rows() -> None:
    leaf = np.repeat([[0, 1]], 500, axis=1).astype(np.int32)
    scores = np.repeat([1.0, 8.0], 500)
    leaf[0] = scores > 1.0
    weights = np.ones((1, 1000), np.uint8)

    found = usual(leaf, weights, scores, 3)

    assert np.exp(found[0]) == pytest.approx(1.0, rel=0.05)
    assert np.exp(found[1]) == pytest.approx(8.0, rel=0.05)
    # A leaf without rows is used to what is usual anywhere.
    assert np.exp(found[2]) == pytest.approx(8.0**0.5, rel=0.01)


def test_novelty_is_judged_by_the_trees_that_did_not_see_the_row() -> None:
    leaf = np.array([[0, 0], [1, 1]], np.int32)
    weights = np.array([[1, 0], [0, 1]], np.uint8)
    used_to = np.log(np.array([2.0, 4.0])).astype(np.float32)

    found = relative(leaf, weights, np.array([4.0, 4.0]), used_to)

    np.testing.assert_allclose(found, [1.0, 2.0], rtol=1e-6)


def test_limits_are_those_of_the_quantile_and_as_far_again_from_the_middle() -> None:
    model = fit_novelty(known(flat()), components=3)[0]

    found = limited(model, np.linspace(0.0, 2.0, 201), 0.9)

    np.testing.assert_allclose(found.limits, [1.8, 2.6])
    assert np.isinf(model.limits).all()
