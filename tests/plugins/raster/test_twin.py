"""The compiled engine and the numpy engine give the same bits."""

from __future__ import annotations

import numpy as np
import pytest
from clothrf_raster import compiled, plain, shading
from clothrf_raster.camera import RasterCamera
from clothrf_raster.config import RasterConfig
from hypothesis import given, settings
from hypothesis import strategies as st

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


def test_triangles_that_share_a_place_are_won_by_the_first():
    mesh = soup(3, 20, 0.2)
    other = SceneMesh(Label.HAND, mesh.vertices, mesh.triangles, (0.9, 0.1, 0.1))

    one, two = both(Scene(meshes=(mesh, other)))

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


def test_finishing_is_equal():
    empty = np.float32(2.5)
    depth = np.array([[0.5, -0.5, 2.5], [2.4999, -2.5, 1e-9]], np.float32)
    outs = [np.empty_like(depth), np.empty_like(depth)]

    compiled.finish(depth, empty, outs[0])
    plain.finish(depth, empty, outs[1])

    assert np.array_equal(outs[0], outs[1], equal_nan=True)
    assert np.isnan(outs[0]).tolist() == [[False, True, True], [False, True, False]]


def test_a_lens_and_a_light_from_behind():
    bent = example_camera(distortion=np.array([0.1, -0.2, 0.001, 0.0, 0.05]))
    scene = example_scene(CAMERA)
    scene = Scene(meshes=scene.meshes, light=Light(direction=(0.8, 0.0, 0.6)))

    assert_same(*both(scene, bent))
