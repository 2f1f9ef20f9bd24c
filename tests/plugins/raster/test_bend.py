"""Drawing straight through a lens: as fine as needed, without cracks, refused where it folds."""

from __future__ import annotations

import dataclasses

import numpy as np
import pytest
from clothrf_raster.bend import Bend, BendCache
from clothrf_raster.camera import RasterCamera
from clothrf_raster.config import RasterConfig

from clothrf_core.camera_model import distort
from clothrf_core.errors import ShapeError
from clothrf_core.lens import Lens
from clothrf_core.scene import Label, Scene, SceneMesh
from clothrf_core.testing.camera import (
    differences,
    example_camera,
    example_scene,
    plane_depth,
    quad,
)

LENSES = [(0.12, -0.25, 0.002, -0.001, 0.08), (-0.3, 0.1, 0.0, 0.0), (0.1, 0.0, 0, 0, 0, 0.2, 0, 0)]


def lens_camera(k, factor=1.0):
    return example_camera(distortion=np.array(k, float), factor=factor)


@pytest.mark.parametrize("k", LENSES)
def test_pieces_bend_by_less_than_their_chord_allows(k):
    camera = lens_camera(k)
    bend = Bend.of(camera)
    scale = np.array([camera.K[0, 0], camera.K[1, 1]])
    rng = np.random.default_rng(1)
    low, high = bend.window[:2], bend.window[2:]
    start = rng.uniform(low, high, (500, 2))
    turn = rng.uniform(0, 2 * np.pi, 500)
    end = start + bend.piece * np.stack([np.cos(turn), np.sin(turn)], 1)
    ends = [(p - camera.K[:2, 2]) / scale for p in (start, end)]
    middle = distort(camera.distortion, 0.5 * (ends[0] + ends[1]))
    chord = 0.5 * (distort(camera.distortion, ends[0]) + distort(camera.distortion, ends[1]))

    assert np.linalg.norm((middle - chord) * scale, axis=1).max() < 0.06
    assert bend.piece >= 4.0


@pytest.mark.parametrize("k", LENSES)
def test_a_large_tilted_plane_has_no_cracks_and_its_analytic_depth(k):
    camera = lens_camera(k)
    corners = np.array([[-2, -2, 0.5], [2, -2, 0.9], [2, 2, 1.4], [-2, 2, 1.0]], float)

    picture = RasterCamera(RasterConfig()).render(Scene(meshes=(quad(camera, corners),)), camera)

    assert (picture.labels == Label.CLOTH).all()
    assert np.abs(picture.frame.depth - plane_depth(camera, corners)).max() < 5e-5


def test_neighbours_of_very_different_size_leave_no_crack():
    camera = lens_camera(LENSES[0])
    rng = np.random.default_rng(0)
    rim = np.array([[-3, -3], [3, -3], [3, 3], [-3, 3]], float)
    inner = rng.uniform(-0.3, 0.3, (1, 2))
    points = np.concatenate([rim, inner])
    points = np.concatenate([points, 1.0 + 0.1 * points[:, :1]], axis=1)
    fan = np.array([[0, 1, 4], [1, 2, 4], [2, 3, 4], [3, 0, 4]], np.int32)
    T = camera.T_world_camera
    mesh = SceneMesh(Label.CLOTH, points @ T[:3, :3].T + T[:3, 3], fan)

    assert RasterCamera(RasterConfig()).render(Scene(meshes=(mesh,)), camera).labels.all()


def test_drawing_directly_and_resampling_a_pinhole_picture_agree():
    camera = lens_camera(LENSES[0])
    scene = example_scene(example_camera())
    lens = Lens.of(camera)
    renderer = RasterCamera(RasterConfig())
    resampled = lens.bend(renderer.render(scene, lens.pinhole(camera)), camera)

    depth, labels = differences(renderer.render(scene, camera), resampled, step=0.006)

    assert depth.size > 20_000
    # Resampling blends facets where they meet; drawing directly does not.
    assert np.percentile(depth, 99) < 6e-4
    assert depth.max() < 2e-3
    assert labels < 1e-3


def test_a_lens_that_folds_outside_the_frame_is_resampled_instead():
    camera = lens_camera((-0.28, 0.0, 0.0, 0.0))
    corners = np.array([[-2, -2, 0.5], [2, -2, 0.9], [2, 2, 1.4], [-2, 2, 1.0]], float)

    depth = (
        RasterCamera(RasterConfig())
        .render(Scene(meshes=(quad(camera, corners),)), camera)
        .frame.depth
    )

    assert Bend.of(camera) is None
    assert np.abs(depth - plane_depth(camera, corners)).max() < 1e-4


def test_a_lens_that_folds_inside_the_frame_is_refused():
    camera = lens_camera((-2.5, 0.0, 0.0, 0.0))

    with pytest.raises(ShapeError, match="expected coefficients that can be undone"):
        RasterCamera(RasterConfig()).render(Scene(meshes=()), camera)


def test_a_camera_that_moves_keeps_its_bend():
    cache = BendCache()
    camera = lens_camera(LENSES[0])
    moved = dataclasses.replace(camera, T_world_camera=np.eye(4))

    assert cache.of(camera) is cache.of(moved)
    assert cache.of(camera) is not cache.of(lens_camera(LENSES[1]))


def test_without_distortion_nothing_is_cut():
    assert Bend.of(example_camera()).piece == 0.0
