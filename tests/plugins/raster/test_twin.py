"""The compiled engine and the numpy engine give the same bits."""

from __future__ import annotations

import dataclasses

import numpy as np
import pytest
from clothrf_raster import compiled, plain, shading
from clothrf_raster.bend import Bend
from clothrf_raster.camera import RasterCamera
from clothrf_raster.canvas import Canvas, code_of, key_of
from clothrf_raster.config import RasterConfig
from clothrf_raster.view import View
from hypothesis import given, settings
from hypothesis import strategies as st

from clothrf_core.errors import ShapeError
from clothrf_core.scene import Label, Light, Scene, SceneMesh, box, capsule, sphere
from clothrf_core.testing.camera import example_camera, example_scene

CAMERA = example_camera()


def both(scene, camera=CAMERA):
    pictures = []
    for engine in ("numba", "numpy"):
        renderer = RasterCamera(RasterConfig(engine=engine))
        pictures.append(renderer.render(scene, camera))
    return pictures


def assert_same(one, two):
    assert np.array_equal(one.labels, two.labels)
    assert np.array_equal(one.frame.depth, two.frame.depth, equal_nan=True)
    assert np.array_equal(one.frame.rgb, two.frame.rgb)


def soup(seed, count, spread):
    rng = np.random.default_rng(seed)
    centre = CAMERA.T_world_camera[:3, 3] + 0.5 * CAMERA.T_world_camera[:3, 2]
    vertices = centre + rng.normal(scale=spread, size=(3 * count, 3))
    triangles = np.arange(3 * count, dtype=np.int32).reshape(-1, 3)
    return SceneMesh(Label.CLOTH, vertices, triangles, (0.3, 0.6, 0.2))


def test_a_scene_of_cloth_hands_and_table():
    one, two = both(example_scene(CAMERA))

    assert len(np.unique(one.labels)) >= 3
    assert_same(one, two)


@settings(max_examples=25, deadline=None)
@given(seed=st.integers(0, 10**6), spread=st.sampled_from([0.02, 0.2, 0.6, 3.0]))
def test_random_triangles_small_large_cut_and_behind(seed, spread):
    one, two = both(Scene(meshes=(soup(seed, 40, spread),)))

    assert_same(one, two)


def test_triangles_that_share_a_place_are_won_by_the_lower_label():
    mesh = soup(3, 20, 0.2)
    other = SceneMesh(Label.HAND, mesh.vertices, mesh.triangles, (0.9, 0.1, 0.1))

    one, two = both(Scene(meshes=(other, mesh)))

    assert_same(one, two)
    assert not (one.labels == Label.HAND).any()


@pytest.mark.parametrize("seed", range(3))
def test_shades_are_equal(seed):
    rng = np.random.default_rng(seed)
    eye, light = rng.normal(size=3), np.array([0.6, 0.0, -0.8])
    meshes = [
        sphere(rng.normal(size=3), 0.1, Label.HAND, (1, 1, 1)),
        capsule(rng.normal(size=3), rng.normal(size=3), 0.1, Label.HAND, (1, 1, 1)),
        box(np.zeros(3), np.ones(3), Label.TABLE, (1, 1, 1)),
        soup(seed, 30, 0.3),
    ]
    for mesh in meshes:
        expected = shading.corner_shades(mesh, eye, light)

        assert np.array_equal(compiled.corner_shades(mesh, eye, light), expected)


def test_finishing_is_equal_and_knows_far_near_and_what_gives_no_depth():
    view = View.of(example_camera(factor=0.1), Bend.none())
    canvas = Canvas.blank(view.width, view.height, view.far, colour=False)
    cloth, steel = code_of(1, measurable=True), code_of(4, measurable=False)
    inverse = np.float32(1.0) / np.array([0.5, 0.1, 2.0, 2.1, 0.09999, 1.0], np.float32)
    for x, (w, code) in enumerate(
        zip(inverse, [cloth, cloth, cloth, cloth, cloth, steel], strict=True)
    ):
        canvas.keys[0, x] = max(canvas.empty, key_of(w, code))
    found = []
    for engine in (compiled, plain):
        depth = np.empty((view.height, view.width), np.float32)
        labels = np.empty((view.height, view.width), np.uint8)
        engine.finish(canvas, view, depth, labels)
        found.append((depth, labels))

    assert np.array_equal(found[0][0], found[1][0], equal_nan=True)
    assert np.array_equal(found[0][1], found[1][1])
    assert np.allclose(found[0][0][0, :3], [0.5, 0.1, 2.0], rtol=2e-6)
    assert found[0][0][0, 4] == np.float32(0.1)
    assert np.isnan(found[0][0][0, [3, 5, 6]]).all()
    assert found[0][1][0, :7].tolist() == [1, 1, 1, 0, 1, 4, 0]


@given(st.floats(0.01, 100.0), st.sampled_from(range(16)))
def test_a_key_keeps_depth_to_two_millionths(depth, label):
    key = key_of(np.float32(1.0 / depth), code_of(label, measurable=True))

    back = 1.0 / float((key & np.int32(-32)).view(np.float32))

    assert abs(back - depth) <= 2.1e-6 * depth
    assert 15 - ((int(key) >> 1) & 15) == label


def test_a_label_that_does_not_fit_is_refused():
    with pytest.raises(ShapeError, match="label: expected 0 to 15 for the raster camera, got 16"):
        code_of(16, measurable=True)


@settings(max_examples=12, deadline=None)
@given(seed=st.integers(0, 10**6), spread=st.sampled_from([0.02, 0.2, 0.6, 3.0]))
def test_random_triangles_through_a_lens(seed, spread):
    bent = example_camera(distortion=np.array([0.1, -0.2, 0.001, 0.0, 0.05]), factor=0.5)
    one, two = both(Scene(meshes=(soup(seed, 20, spread),)), bent)

    assert_same(one, two)


def test_a_lens_and_a_light_from_behind():
    bent = example_camera(distortion=np.array([0.1, -0.2, 0.001, 0.0, 0.05]))
    scene = example_scene(CAMERA)
    scene = Scene(meshes=scene.meshes, light=Light(direction=(0.8, 0.0, 0.6)))

    assert_same(*both(scene, bent))


@pytest.mark.parametrize("width", [37, 38, 39, 40])
def test_rows_of_any_number_of_pixels(width):
    camera = example_camera(factor=0.125)
    camera = dataclasses.replace(camera, width=width)

    one, two = both(Scene(meshes=(soup(5, 40, 0.2),)), camera)

    assert_same(one, two)
    assert len(np.unique(one.frame.rgb.reshape(-1, 3), axis=0)) > 10
