"""The arms of a recording as a film: real kinematics, a real renderer."""

from __future__ import annotations

import io

import numpy as np
import pytest
from clothrf_zenoh.draw import arm_scene, film, read_footage, spectator
from clothrf_zenoh.keys import Keys
from clothrf_zenoh.messages import JointState, PoseArray, encode_joint_state, encode_pose_array
from clothrf_zenoh.record import McapFile

from clothrf_core.camera_model import project
from clothrf_core.errors import ConfigError, DataError
from clothrf_core.registry import Registry
from clothrf_core.scene import Label, box

pytest.importorskip("pinocchio")
image = pytest.importorskip("PIL.Image")

REGISTRY = Registry.installed()
ARM = REGISTRY.build("arm", "yumi")
KEYS = Keys("yumi")


WANTED = np.array([[0.45, -0.1, 0.35], [0.45, 0.1, 0.35]])


def targets(stamp):
    return encode_pose_array(PoseArray(stamp, "world", WANTED, np.tile([0.0, 0, 0, 1], (2, 1))))


@pytest.fixture
def recording(tmp_path):
    """One second of the left elbow moving by half a radian."""
    path = tmp_path / "run.mcap"
    with McapFile(path, KEYS.topics) as file:
        for i in range(51):
            q = np.array(ARM.ready)
            q[3] += 0.01 * i
            stamp = 10**18 + 20_000_000 * i
            data = encode_joint_state(JointState(stamp, "RUNNING", ARM.joint_names, q))
            file.add(KEYS.joint_states, data, sequence=i + 1, stamp_ns=stamp, received_ns=stamp)
            if i == 10:
                file.add(KEYS.grasp_targets, targets(stamp), sequence=1, stamp_ns=stamp,
                         received_ns=stamp)  # fmt: skip
    return path


def test_postures_and_targets_come_back_with_their_times(recording):
    footage = read_footage(recording, ARM.joint_names)
    assert np.allclose(footage.times, 0.02 * np.arange(51), atol=1e-9)
    assert np.isclose(footage.postures[-1, 3] - footage.postures[0, 3], 0.5)
    assert np.allclose(footage.target_times, [0.2])
    assert np.array_equal(footage.targets, [WANTED])


def test_targets_are_shown_from_when_they_are_told_until_they_are_stale(recording):
    footage = read_footage(recording, ARM.joint_names)
    shown = [len(footage.at(t)[1]) for t in (0.1, 0.25, 0.6, 0.8)]
    assert shown == [0, 2, 2, 0]


def test_a_film_has_its_length_and_its_arms_move(recording):
    data = film(recording, ARM, REGISTRY, rate_hz=5.0)
    with image.open(io.BytesIO(data)) as gif:
        assert gif.n_frames == 6
        pictures = []
        for i in (0, 5):
            gif.seek(i)
            pictures.append(np.array(gif.convert("RGB"), int))
    assert (np.abs(pictures[0] - pictures[1]).max(axis=2) > 30).sum() > 500


def test_the_grippers_are_drawn_where_they_are():
    ground = box(np.array([0.0, -0.6, -0.04]), np.array([1.1, 0.6, -0.02]), Label.TABLE, (1, 1, 1))
    renderer = REGISTRY.build("camera", "raster")
    labels = renderer.render(arm_scene(ARM, ARM.ready, WANTED, ground), spectator()).labels
    pixels, _ = project(spectator(), ARM.grasp_points(ARM.ready))
    for u, v in np.rint(pixels).astype(int):
        assert (labels[v - 12 : v + 13, u - 12 : u + 13] == Label.GRIPPER).any()


def test_body_and_targets_are_drawn():
    ground = box(np.array([0.0, -0.6, -0.04]), np.array([1.1, 0.6, -0.02]), Label.TABLE, (1, 1, 1))
    meshes = arm_scene(ARM, ARM.ready, WANTED, ground).meshes
    assert sum(mesh.label == Label.TABLE for mesh in meshes) == 1 + len(ARM.fixtures())
    balls = [mesh.vertices.mean(axis=0) for mesh in meshes if mesh.label == Label.OCCLUDER]
    assert np.allclose(balls, WANTED, atol=1e-3)


def test_a_recording_of_other_arms_is_refused(recording):
    with pytest.raises(DataError, match="expected the joints other_0"):
        read_footage(recording, tuple(f"other_{i}" for i in range(14)))


def test_a_recording_without_states_is_refused(tmp_path):
    with McapFile(tmp_path / "empty.mcap", KEYS.topics):
        pass
    with pytest.raises(DataError, match="expected joint states"):
        read_footage(tmp_path / "empty.mcap", ARM.joint_names)


def test_a_camera_that_does_not_draw_is_refused(recording, tmp_path, monkeypatch):
    registry = Registry.installed()
    monkeypatch.setattr(Registry, "build", lambda *_: object())
    with pytest.raises(ConfigError, match="expected one that draws"):
        film(recording, ARM, registry, camera="folder")
