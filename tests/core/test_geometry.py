import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from clothrf_core.geometry import (
    apply,
    inverse,
    look_at,
    nearest_rotation,
    rotation_angle,
    rotation_vector,
    transform,
)

angles = st.floats(-3.1, 3.1)


@given(angles, angles, angles)
def test_a_rotation_vector_gives_a_rotation(x, y, z):
    R = rotation_vector(np.array([x, y, z]))
    assert np.allclose(R @ R.T, np.eye(3), atol=1e-9)
    assert np.isclose(np.linalg.det(R), 1.0)


@pytest.mark.parametrize("angle", [1e-10, 1e-4, 1.0, np.pi - 1e-6])
def test_the_angle_of_a_rotation_vector_comes_back(angle):
    assert np.isclose(rotation_angle(rotation_vector(np.array([0.0, angle, 0.0]))), angle)


def test_the_inverse_undoes_a_transform(rng):
    T = transform(rotation_vector(rng.normal(size=3)), rng.normal(size=3))
    points = rng.normal(size=(5, 3))
    assert np.allclose(apply(inverse(T), apply(T, points)), points)


def test_the_nearest_rotation_repairs_a_drifted_one(rng):
    R = rotation_vector(np.array([0.2, -0.4, 0.9]))
    assert np.abs(nearest_rotation(R + 1e-3 * rng.normal(size=(3, 3))) - R).max() < 3e-3


def test_the_nearest_rotation_never_mirrors():
    assert np.isclose(np.linalg.det(nearest_rotation(np.diag([1.0, 1.0, -1.0]))), 1.0)


def test_a_camera_that_looks_at_a_point_has_it_on_its_axis():
    T = look_at(np.array([1.0, 2.0, 3.0]), np.array([0.0, 0.5, 0.2]))
    local = apply(inverse(T), np.array([[0.0, 0.5, 0.2]]))[0]
    assert np.allclose(local[:2], 0.0, atol=1e-12)
    assert local[2] > 0


def test_a_camera_that_looks_at_something_has_up_on_top():
    T = look_at(np.array([1.0, 0.0, 0.5]), np.zeros(3))
    assert T[2, 1] < 0


def test_looking_straight_down_is_possible():
    T = look_at(np.array([0.0, 0.0, 1.0]), np.zeros(3))
    assert np.allclose(T[:3, :3] @ T[:3, :3].T, np.eye(3))
