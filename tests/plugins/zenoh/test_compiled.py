"""The compiled comparisons against plain ones, number by number."""

from __future__ import annotations

import numpy as np
import pytest
from clothrf_zenoh import checks, compiled
from hypothesis import given
from hypothesis import strategies as st

# What is not finite is meant here.
pytestmark = pytest.mark.filterwarnings("ignore:invalid value")

J = 14
ODD = [np.nan, np.inf, -np.inf, 0.0, 1.0, -1.0]


def first(good):
    """Flat index of the first row, then joint, that is not good; -1 if all are."""
    flat = np.concatenate(good)
    return -1 if flat.all() else int(np.argmin(flat))


@st.composite
def rows(draw, count):
    """`count` vectors of numbers near the limits, some of them exactly on them or none at all."""
    rng = np.random.default_rng(draw(st.integers(0, 2**32 - 1)))
    found = [rng.uniform(-1.02, 1.02, J) for _ in range(count)]
    for _ in range(draw(st.integers(0, 2))):
        found[rng.integers(count)][rng.integers(J)] = draw(st.sampled_from(ODD))
    return found


@given(rows(3), st.floats(0.0, 2.5))
def test_a_command_is_judged_as_by_numpy(values, window):
    q, qd, before = values
    limits = np.array([np.full(J, -1.0), np.full(J, 1.0), np.linspace(0.9, 1.1, J)])
    low, high, v = limits
    good = [(q >= low) & (q <= high), np.abs(qd) <= v, np.abs(q - before) <= v * window]

    assert compiled.bad_command(q, qd, before, window, limits) == first(good)


@given(rows(5))
def test_an_output_is_judged_as_by_numpy(values):
    q0, v0, q, v, a = values
    limits = np.array([np.full(J, -1.0), *np.linspace(0.95, 1.99, 5 * J).reshape(5, J)])
    low, high, *most = limits
    good = [(q >= low) & (q <= high)]
    good += [np.abs(x) <= limit for x, limit in zip((v, q - q0, a, v - v0), most, strict=True)]

    assert compiled.bad_motion(q0, v0, q, v, a, limits) == first(good)


@given(rows(2), st.floats(0.0, 2.0))
def test_postures_are_compared_as_by_numpy(values, most):
    one, other = values

    assert compiled.far_apart(one, other, most) == first([np.abs(one - other) <= most])


@given(st.lists(st.floats(-1.1, 1.1) | st.sampled_from(ODD), min_size=12, max_size=12))
def test_grippers_are_judged_as_by_numpy(numbers):
    points, before = np.array(numbers).reshape(2, 2, 3)
    box, step = np.array([[-1.0, -1.0, -1.0], [1.0, 1.0, 1.0]]), 1.2
    inside = ((points >= box[0]) & (points <= box[1])).all(axis=1)
    slow = np.linalg.norm(points - before, axis=1) <= step
    wanted = next(
        (i if not inside[i] else 2 + i for i in range(2) if not (inside[i] and slow[i])), -1
    )

    assert compiled.bad_grippers(points, before, box, step) == wanted


def s_curve(a, j):
    return np.array([a * a / j, 0.5 / a, 0.5 * a / j, 1.0 / j])


def half(v, a, j):
    return np.where(v > a * a / j, 0.5 * (v / a + a / j), np.sqrt(v / j))


@pytest.fixture
def curves():
    rng = np.random.default_rng(0)
    return rng.uniform(5.0, 20.0, J), rng.uniform(300.0, 2000.0, J)


@pytest.mark.parametrize("seed", range(20))
def test_the_pursuit_equals_its_formula(seed, curves):
    rng = np.random.default_rng(seed)
    a, j = curves
    pursued, q, qd = rng.normal(0, 0.02, J), rng.normal(0, 0.02, J), rng.normal(0, 1.0, J)
    q[3], qd[4] = pursued[3], 0.0
    quick, creep = 0.005, 0.0004
    reach = np.maximum(quick * np.abs(qd), creep)
    x = pursued + np.clip(q - pursued, -reach, reach)
    left = np.abs(q - x) / (8 * reach)
    ahead = qd * half(np.abs(qd), a, j) * np.where(left > 0, np.clip(1.5 - left, 0.0, 1.0), 1.0)

    both = np.empty((2, J))
    compiled.walk(pursued, q, qd, s_curve(a, j), quick, creep, 8.0, both)

    np.testing.assert_allclose(both, [x, x + ahead], rtol=0, atol=1e-15)


@pytest.mark.parametrize("seed", range(20))
def test_the_stopping_point_equals_its_formula(seed, curves):
    rng = np.random.default_rng(seed)
    a, j = curves
    q, qd, qdd = rng.normal(0, 1.0, J), rng.normal(0, 1.0, J), rng.normal(0, 10.0, J)
    qd[2] = 0.0
    release = np.maximum(np.sign(qd) * qdd, 0.0) / j
    v = np.abs(qd) + 0.5 * j * release * release
    wanted = q + np.sign(qd) * v * (release + half(v, a, j))

    found = np.empty(J)
    compiled.rest(q, qd, qdd, s_curve(a, j), found)

    np.testing.assert_allclose(found, wanted, rtol=1e-14, atol=1e-15)


def test_every_row_of_a_refusal_has_a_name_and_a_reason():
    assert len(checks.COMMAND_ROWS) == 3
    assert len(checks.MOTION_ROWS) == 5


def test_an_array_of_another_kind_is_an_error_and_compiles_nothing():
    with pytest.raises(TypeError, match="No matching definition"):
        compiled.far_apart(np.zeros(J, int), np.zeros(J, int), 1.0)
