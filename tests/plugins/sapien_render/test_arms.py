"""Arms drawn from capsules."""

from __future__ import annotations

import numpy as np
import pytest
from clothrf_sapien.arms import arm_mesh

from clothrf_core.errors import ShapeError
from clothrf_core.scene import Label

STARTS = np.array([[0.0, 0.0, 0.0], [0.0, 0.0, 0.4]])
ENDS = np.array([[0.0, 0.0, 0.4], [0.3, 0.0, 0.4]])
RADII = np.array([0.06, 0.05])


def test_every_vertex_lies_on_the_surface_of_some_capsule():
    mesh = arm_mesh(STARTS, ENDS, RADII)

    axis = ENDS - STARTS
    t = np.einsum("vnx,nx->vn", mesh.vertices[:, None] - STARTS, axis) / (axis**2).sum(1)
    nearest = STARTS + np.clip(t, 0, 1)[:, :, None] * axis
    off = np.linalg.norm(mesh.vertices[:, None] - nearest, axis=2) - RADII
    assert np.abs(off).min(axis=1).max() < 1e-9
    assert mesh.label == Label.GRIPPER
    assert mesh.triangles.max() == len(mesh.vertices) - 1


def test_no_links_are_an_empty_mesh():
    mesh = arm_mesh(np.zeros((0, 3)), np.zeros((0, 3)), np.zeros(0))

    assert mesh.vertices.shape == (0, 3)
    assert mesh.triangles.shape == (0, 3)


def test_arrays_that_do_not_fit_are_refused():
    with pytest.raises(ShapeError, match=r"expected starts and ends of shape \(2, 3\) for 2 radii"):
        arm_mesh(STARTS, ENDS[:1], RADII)
