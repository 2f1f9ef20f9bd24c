"""What is kept between frames never changes a picture."""

from __future__ import annotations

import threading

import numpy as np
import pytest
from clothrf_raster import plain
from clothrf_raster.camera import RasterCamera, engine
from clothrf_raster.config import RasterConfig

from clothrf_core.errors import ConfigError, StaleFrame
from clothrf_core.provider import BuildContext
from clothrf_core.registry import Registry
from clothrf_core.scene import Label, Light, Scene, SceneMesh, sphere
from clothrf_core.testing.camera import example_camera, example_scene

CAMERA = example_camera()


def fresh(scene, camera=CAMERA):
    return RasterCamera(RasterConfig()).render(scene, camera)


def assert_same(one, two):
    assert np.array_equal(one.labels, two.labels)
    assert np.array_equal(one.frame.depth, two.frame.depth, equal_nan=True)
    assert np.array_equal(one.frame.rgb, two.frame.rgb)


def ball(x, label):
    centre = CAMERA.T_world_camera @ np.array([x, 0.0, 0.6, 1.0])
    return sphere(centre[:3], 0.05, label, (0.5, 0.2, 0.7))


def test_every_frame_of_a_changing_scene_equals_one_drawn_from_scratch():
    renderer = RasterCamera(RasterConfig())
    rest = example_scene(CAMERA).meshes
    still, moved = ball(0.1, Label.OCCLUDER), ball(-0.1, Label.OCCLUDER)
    light = Light(direction=(0.0, 0.6, -0.8))
    frames = [
        Scene(meshes=rest),
        Scene(meshes=rest),
        Scene(meshes=(*rest, still)),
        Scene(meshes=(*rest, still)),
        Scene(meshes=(*rest, moved)),
        Scene(meshes=(*rest, moved)),
        Scene(meshes=(*rest, moved), light=light),
        Scene(meshes=(*rest, moved), light=light, background=(0.9, 0.1, 0.1)),
        Scene(meshes=(moved,)),
        Scene(meshes=()),
        Scene(meshes=()),
        Scene(meshes=rest[::-1]),
        Scene(meshes=(ball(0.0, Label.BACKDROP), *rest)),
    ]

    for frame in frames:
        assert_same(renderer.render(frame, CAMERA), fresh(frame))


def test_a_table_whose_owner_writes_into_its_arrays_is_drawn_anew():
    vertices = np.array(ball(0.0, Label.TABLE).vertices)
    mesh = SceneMesh(Label.TABLE, vertices, ball(0.0, Label.TABLE).triangles)
    renderer = RasterCamera(RasterConfig())
    for _ in range(3):
        renderer.render(Scene(meshes=(mesh,)), CAMERA)

    vertices += 0.05

    assert_same(renderer.render(Scene(meshes=(mesh,)), CAMERA), fresh(Scene(meshes=(mesh,))))


def test_another_camera_is_not_mistaken_for_the_first():
    renderer = RasterCamera(RasterConfig())
    scene = example_scene(CAMERA)
    other = example_camera(factor=0.5)

    for camera in (CAMERA, other, CAMERA):
        assert_same(renderer.render(scene, camera), fresh(scene, camera))


def test_threads_share_one_camera():
    renderer = RasterCamera(RasterConfig())
    scenes = [
        Scene(meshes=(*example_scene(CAMERA).meshes, ball(x, Label.HAND))) for x in (-0.1, 0.1)
    ]
    expected = [fresh(scene) for scene in scenes]
    found = [[], []]

    def work(k):
        for _ in range(5):
            found[k].append(renderer.render(scenes[k], CAMERA))

    threads = [threading.Thread(target=work, args=(k,)) for k in range(2)]
    for thread in threads:
        thread.start()
    for thread in threads:
        thread.join()

    for k in range(2):
        assert len(found[k]) == 5
        for picture in found[k]:
            assert_same(picture, expected[k])


class Turning:
    """A world that shows a new instant only after `step`."""

    def __init__(self):
        self.stamp = 0

    def step(self):
        self.stamp += 33

    def scene(self):
        return Scene(meshes=example_scene(CAMERA).meshes, stamp_ns=self.stamp)

    def camera_model(self):
        return CAMERA


def test_read_draws_the_world_and_stamps_increase():
    world = Turning()
    with RasterCamera(RasterConfig(), BuildContext(world=world)) as camera:
        first = camera.read()
        world.step()
        second = camera.read()

        assert (first.stamp_ns, second.stamp_ns) == (0, 33)
        with pytest.raises(StaleFrame, match=r"expected a frame later than 33 ns within 0\.01 s"):
            camera.read(timeout_s=0.01)


def test_read_waits_for_a_world_that_another_thread_advances():
    world = Turning()
    with RasterCamera(RasterConfig(), BuildContext(world=world)) as camera:
        camera.read()
        timer = threading.Timer(0.02, world.step)
        timer.start()

        assert camera.read(timeout_s=5.0).stamp_ns == 33
        timer.join()


def test_read_without_a_world_says_so():
    with (
        RasterCamera(RasterConfig()) as camera,
        pytest.raises(ConfigError, match="camera 'raster' has no world to look at"),
    ):
        camera.read()


def test_it_is_found_by_its_entry_point_and_built():
    registry = Registry.installed()

    camera = registry.build("camera", "raster", RasterConfig(engine="numpy"))

    assert fresh(example_scene(CAMERA)).labels.any()
    assert camera.render(example_scene(CAMERA), CAMERA).labels.any()


def test_the_numpy_engine_serves_where_numba_is_missing(monkeypatch):
    monkeypatch.setattr("importlib.util.find_spec", lambda name: None)

    assert engine(RasterConfig()) is plain
