import numpy as np
import pytest

from clothrf_core.errors import ShapeError
from clothrf_core.scene import Label, Pattern, SceneMesh, along, box, capsule, sphere

RED = (1.0, 0.0, 0.0)


def closed(mesh):
    """Every edge of a closed surface belongs to two triangles."""
    _, welded = np.unique(np.round(mesh.vertices, 9), axis=0, return_inverse=True)
    faces = np.sort(welded.ravel()[mesh.triangles], axis=1)
    faces = faces[(np.diff(faces, axis=1) > 0).all(axis=1)]
    edges = faces[:, [[0, 1], [1, 2], [0, 2]]].reshape(-1, 2)
    return set(np.unique(edges, axis=0, return_counts=True)[1]) == {2}


def test_a_sphere_has_its_radius_everywhere():
    mesh = sphere(np.array([1.0, 2.0, 3.0]), 0.2, Label.HAND, RED)
    assert np.allclose(np.linalg.norm(mesh.vertices - [1.0, 2.0, 3.0], axis=1), 0.2)


def test_a_capsule_keeps_its_distance_from_its_axis():
    start, end = np.array([0.0, 0.1, 0.2]), np.array([0.3, 0.1, 0.1])
    mesh = capsule(start, end, 0.05, Label.HAND, RED)
    t = np.clip((mesh.vertices - start) @ (end - start) / ((end - start) @ (end - start)), 0, 1)
    nearest = start + t[:, None] * (end - start)
    assert np.allclose(np.linalg.norm(mesh.vertices - nearest, axis=1), 0.05)


@pytest.mark.parametrize(
    "mesh",
    [
        sphere(np.zeros(3), 1.0, Label.HAND, RED),
        capsule(np.zeros(3), np.ones(3), 0.3, Label.HAND, RED),
        box(np.zeros(3), np.ones(3), Label.TABLE, RED),
    ],
    ids=["sphere", "capsule", "box"],
)
def test_a_body_is_closed(mesh):
    assert closed(mesh)


@pytest.mark.parametrize("axis", [[0, 0, 1], [0, 0, -1], [0.6, 0.0, 0.8], [-0.36, 0.48, -0.8]])
def test_a_turned_capsule_is_the_capsule_built_there(axis):
    axis, start = np.array(axis, float), np.array([0.1, -0.2, 0.3])
    template = capsule(np.zeros(3), np.array([0.0, 0.0, 0.1]), 0.02, Label.HAND, RED)
    turned = along(template, start, axis)
    t = np.clip((turned.vertices - start) @ axis, 0.0, 0.1)
    assert np.allclose(np.linalg.norm(turned.vertices - start - t[:, None] * axis, axis=1), 0.02)


def test_a_triangle_of_missing_vertices_is_refused():
    with pytest.raises(ShapeError, match="expected indices below 3, got 3"):
        SceneMesh(Label.CLOTH, np.zeros((3, 3)), np.array([[0, 1, 3]], np.int32))


def test_a_pattern_of_missing_colours_is_refused():
    with pytest.raises(ShapeError, match="all below 2"):
        Pattern(np.array([[0, 2]], np.uint8), np.zeros((2, 3)))


def test_a_pattern_needs_a_place_for_every_vertex():
    pattern = Pattern(np.zeros((1, 1), np.uint8), np.zeros((1, 3)))
    with pytest.raises(ShapeError, match=r"SceneMesh.uv: expected float64 of shape \(8, 2\)"):
        box(np.zeros(3), np.ones(3), Label.TABLE, RED).printed(pattern, np.zeros((7, 2)))


def test_copies_look_like_their_mesh_until_somebody_writes_into_it():
    vertices = np.eye(3)
    mesh = SceneMesh(Label.CLOTH, vertices, np.array([[0, 1, 2]], np.int32))
    kept = mesh.copy()
    assert kept.looks_like(mesh)
    vertices += 1.0
    assert not kept.looks_like(mesh)
