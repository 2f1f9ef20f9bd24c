"""Patterns on meshes: where they lie, the same bits from both engines, nothing else changed."""

from __future__ import annotations

import dataclasses

import numpy as np
import pytest
from clothrf_raster.camera import RasterCamera
from clothrf_raster.config import RasterConfig

from clothrf_core.scene import Label, Light, Pattern, Scene
from clothrf_core.testing.camera import example_camera, example_scene, quad

CAMERA = example_camera()
CHEQUER = Pattern(
    (np.indices((8, 12)).sum(axis=0) % 2).astype(np.uint8),
    np.array([[1.0, 1.0, 1.0], [0.0, 0.0, 1.0]]),
)


def printed(mesh, pattern=CHEQUER):
    places = mesh.vertices[:, :2] - mesh.vertices[:, :2].min(axis=0)
    return mesh.printed(pattern, places / np.maximum(places.max(axis=0), 1e-9))


def picture(scene, camera=CAMERA, engine="numba"):
    return RasterCamera(RasterConfig(engine=engine)).render(scene, camera)


@pytest.mark.parametrize("bent", [False, True])
def test_both_engines_print_the_same_bits(bent):
    distortion = np.array([-0.2, 0.05, 0.001, 0.0, 0.0]) if bent else CAMERA.distortion
    camera = dataclasses.replace(CAMERA, distortion=distortion)
    scene = Scene(meshes=tuple(printed(mesh) for mesh in example_scene(CAMERA).meshes))

    one, two = picture(scene, camera), picture(scene, camera, "numpy")

    assert np.array_equal(one.frame.rgb, two.frame.rgb)
    assert len(np.unique(one.frame.rgb.reshape(-1, 3), axis=0)) > 100


def test_depth_and_labels_are_those_of_the_plain_scene():
    scene = example_scene(CAMERA)
    some = dataclasses.replace(scene, meshes=(printed(scene.meshes[0]), *scene.meshes[1:]))

    one, two = picture(some), picture(scene)

    assert np.array_equal(one.labels, two.labels)
    assert np.array_equal(one.frame.depth, two.frame.depth, equal_nan=True)
    other = two.labels != scene.meshes[0].label
    assert np.array_equal(one.frame.rgb[other], two.frame.rgb[other])


def test_a_pattern_on_a_slanted_wall_lies_where_the_lens_says():
    corners = np.array([[-0.3, -0.2, 0.7], [0.3, -0.2, 1.2], [0.3, 0.2, 1.2], [-0.3, 0.2, 0.7]])
    wall = quad(CAMERA, corners, Label.TABLE)
    places = np.array([[0.0, 0.0], [1.0, 0.0], [1.0, 1.0], [0.0, 1.0]])
    scene = Scene(meshes=(wall.printed(CHEQUER, places),), light=Light(intensity=0.0, ambient=1.0))

    found = picture(scene)

    y, x = np.nonzero(found.labels == Label.TABLE)
    pixels = np.stack([x, y, np.ones_like(x)], axis=1) @ np.linalg.inv(CAMERA.K).T
    point = pixels * found.frame.depth[y, x][:, None]
    column = np.floor(12 * (point[:, 0] + 0.3) / 0.6)
    row = np.floor(8 * (point[:, 1] + 0.2) / 0.4)
    blue = (column + row) % 2 == 1
    assert (blue == (found.frame.rgb[y, x, 0] == 0)).mean() > 0.98  # the rest: edges of texels
    assert 0.4 < blue.mean() < 0.6


def test_another_pattern_on_a_still_table_is_drawn_anew():
    table = quad(CAMERA, np.array([[-1, -1, 2], [1, -1, 2], [1, 1, 2], [-1, 1, 2.0]]), Label.TABLE)
    plain = Pattern(np.zeros((1, 1), np.uint8), np.array([[0.0, 1.0, 0.0]]))
    renderer = RasterCamera(RasterConfig())
    scenes = [Scene(meshes=(printed(table, pattern),)) for pattern in (CHEQUER, CHEQUER, plain)]

    for scene in (*scenes, Scene(meshes=(table,))):
        again = renderer.render(scene, CAMERA).frame.rgb
        assert np.array_equal(again, picture(scene).frame.rgb)
