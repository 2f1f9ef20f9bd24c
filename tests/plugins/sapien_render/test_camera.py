"""SAPIEN's pictures: the contract, agreement with the CPU renderer, shadows, what is kept."""

from __future__ import annotations

import dataclasses
import threading

import numpy as np
import pytest
from clothrf_sapien.camera import SapienCamera
from clothrf_sapien.camera_config import SapienCameraConfig

from clothrf_core.interfaces import RenderedCamera
from clothrf_core.provider import BuildContext
from clothrf_core.scene import Label, Light, Pattern, Scene, SceneMesh, sphere
from clothrf_core.testing.camera import checks, differences, example_camera, example_scene, quad

raster = pytest.importorskip("clothrf_raster.camera")
raster_config = pytest.importorskip("clothrf_raster.config")

pytestmark = [pytest.mark.vulkan, pytest.mark.usefixtures("vulkan")]


@pytest.fixture(scope="module")
def camera(vulkan):
    with SapienCamera(SapienCameraConfig()) as opened:
        yield opened


@pytest.mark.parametrize("check", list(checks()), ids=lambda check: check.__name__)
def test_each_promise_is_kept(camera, check):
    check(camera)


def test_it_is_a_rendered_camera(camera):
    assert isinstance(camera, RenderedCamera)


def both(camera, scene, model):
    drawn = raster.RasterCamera(raster_config.RasterConfig()).render(scene, model)
    return camera.render(scene, model), drawn


def test_patterns_agree_with_the_cpu_renderer(camera):
    model = example_camera()
    chequer = Pattern(
        (np.indices((6, 8)).sum(axis=0) % 2).astype(np.uint8),
        np.array([[0.1, 0.5, 0.5], [1, 0, 0]]),
    )
    cloth, *rest = example_scene(model).meshes
    places = cloth.vertices[:, :2] - cloth.vertices[:, :2].min(axis=0)
    printed = cloth.printed(chequer, places / places.max(axis=0))

    one, two = both(camera, Scene(meshes=(printed, *rest)), model)

    off = np.abs(one.frame.rgb.astype(int) - two.frame.rgb).max(axis=2) > 3
    assert off.mean() < 0.02  # along the edges of texels
    assert len(np.unique(one.frame.rgb[one.labels == Label.CLOTH], axis=0)) > 20


@pytest.mark.parametrize(
    "model",
    [
        example_camera(),
        example_camera(factor=2.0),
        dataclasses.replace(
            example_camera(), K=np.array([[310.0, 12.0, 140.0], [0, 300.0, 110.0], [0, 0, 1.0]])
        ),
    ],
    ids=["small", "large", "skewed"],
)
def test_depth_and_labels_agree_with_the_cpu_renderer(camera, model):
    one, two = both(camera, example_scene(model), model)

    depth, labels = differences(one, two)

    assert depth.size > 20_000
    assert depth.max() < 2e-5
    assert labels == 0.0
    assert np.mean(one.labels != two.labels) < 1e-3


def test_a_distorted_picture_agrees_with_the_cpu_renderer(camera):
    model = example_camera(distortion=np.array([0.12, -0.25, 0.002, -0.001, 0.08]))

    pictures = both(camera, example_scene(example_camera()), model)
    depth, labels = differences(*pictures, step=0.006)

    assert depth.size > 20_000
    # Resampling blends facets where they meet; drawing directly does not.
    assert np.percentile(depth, 99) < 6e-4
    assert depth.max() < 2e-3
    assert labels == 0.0


def test_the_colour_agrees_with_the_cpu_renderer(camera):
    model = example_camera()
    scene = dataclasses.replace(
        example_scene(model), light=Light(direction=(0.0, 0.6, -0.8)), background=(0.1, 0.4, 0.2)
    )
    one, two = both(camera, scene, model)

    same = one.labels == two.labels
    error = np.abs(one.frame.rgb.astype(int) - two.frame.rgb)[same]
    assert error.max() <= 6
    assert error.mean() < 0.5


def test_a_surface_shades_what_is_behind_it_only_with_shadows(camera):
    model = example_camera()
    wall = np.array([[-2, -2, 1.2], [2, -2, 1.2], [2, 2, 1.2], [-2, 2, 1.2]], float)
    plate = 0.5 * np.array([[-0.2, -0.2, 2.0], [0.2, -0.2, 2.0], [0.2, 0.2, 2.0], [-0.2, 0.2, 2]])
    view = model.T_world_camera[:3, :3]
    light = Light(direction=tuple(view @ np.array([0.6, 0.0, 0.8])), intensity=0.8, ambient=0.2)
    meshes = (quad(model, wall, Label.BACKDROP), quad(model, plate, Label.CLOTH))
    scene = Scene(meshes=meshes, light=light)

    plain = camera.render(scene, model)
    with SapienCamera(SapienCameraConfig(shadows=True)) as shadowed:
        dark = shadowed.render(scene, model)

    assert np.array_equal(plain.labels, dark.labels)
    backdrop = plain.labels == Label.BACKDROP
    level = plain.frame.rgb[..., 0][backdrop].astype(int)
    assert np.ptp(level) <= 1
    shade = dark.frame.rgb[..., 0][backdrop].astype(int)
    cast = shade < level.min() - 20
    # The plate hides 0.2 x 0.2 m of a wall 1.2 m away; a part lies behind the plate itself.
    assert 0.3 < cast.sum() / ((0.2 / 1.2) ** 2 * model.K[0, 0] * model.K[1, 1]) < 1.0
    assert (shade[~cast] >= level.min() - 20).all()
    cloth = plain.labels == Label.CLOTH
    same = (plain.frame.rgb == dark.frame.rgb).all(axis=2)[cloth]
    assert same.mean() > 0.95


def test_a_moving_cloth_is_drawn_anew_and_nothing_piles_up(camera):
    model = example_camera()
    scene = example_scene(model)
    for k in range(30):
        cloth = scene.meshes[0]
        moved = dataclasses.replace(cloth, vertices=cloth.vertices + 0.001 * k)
        picture = camera.render(Scene(meshes=(moved, *scene.meshes[1:])), model)
    fresh = SapienCamera(SapienCameraConfig()).render(
        Scene(meshes=(moved, *scene.meshes[1:])), model
    )

    assert np.array_equal(picture.frame.depth, fresh.frame.depth, equal_nan=True)
    assert np.array_equal(picture.frame.rgb, fresh.frame.rgb)
    assert len(camera._studio._scene.entities) == len(scene.meshes) + 2


def test_meshes_without_triangles_are_no_trouble(camera):
    nothing = SceneMesh(Label.CLOTH, np.zeros((0, 3)), np.zeros((0, 3), np.int32))

    assert not camera.render(Scene(meshes=(nothing,)), example_camera()).labels.any()


def test_threads_may_share_one_camera(camera):
    model = example_camera()
    scene = example_scene(model)
    expected = camera.render(scene, model)
    found = []
    threads = [
        threading.Thread(target=lambda: found.append(camera.render(scene, model))) for _ in range(4)
    ]
    for thread in threads:
        thread.start()
    for thread in threads:
        thread.join()

    assert len(found) == 4
    for picture in found:
        assert np.array_equal(picture.frame.depth, expected.frame.depth, equal_nan=True)


def test_it_reads_the_world_it_was_built_with(camera):
    class Still:
        def scene(self):
            ball = sphere(np.array([0.35, -0.05, 0.2]), 0.1, Label.HAND, (0.7, 0.5, 0.4))
            return Scene(meshes=(ball,), stamp_ns=5)

        def camera_model(self):
            return example_camera()

    with SapienCamera(SapienCameraConfig(), BuildContext(world=Still())) as opened:
        frame = opened.read()

    assert frame.stamp_ns == 5
    assert np.isfinite(frame.depth).sum() > 1000
