"""The arms of a recording as a film: real kinematics, a real renderer."""

from __future__ import annotations

import io

import numpy as np
import pytest
from clothrf_zenoh.draw import arm_scene, film, read_postures, spectator
from clothrf_zenoh.keys import Keys
from clothrf_zenoh.messages import JointState, encode_joint_state
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
    return path


def test_postures_come_back_with_their_times(recording):
    times, postures = read_postures(recording, ARM.joint_names)
    assert np.allclose(times, 0.02 * np.arange(51))
    assert np.isclose(postures[-1, 3] - postures[0, 3], 0.5)


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
    labels = renderer.render(arm_scene(ARM, ARM.ready, ground), spectator()).labels
    pixels, _ = project(spectator(), ARM.grasp_points(ARM.ready))
    for u, v in np.rint(pixels).astype(int):
        assert (labels[v - 12 : v + 13, u - 12 : u + 13] == Label.GRIPPER).any()


def test_a_recording_of_other_arms_is_refused(recording):
    with pytest.raises(DataError, match="expected the joints other_0"):
        read_postures(recording, tuple(f"other_{i}" for i in range(14)))


def test_a_recording_without_states_is_refused(tmp_path):
    with McapFile(tmp_path / "empty.mcap", KEYS.topics):
        pass
    with pytest.raises(DataError, match="expected joint states"):
        read_postures(tmp_path / "empty.mcap", ARM.joint_names)


def test_a_camera_that_does_not_draw_is_refused(recording, tmp_path, monkeypatch):
    registry = Registry.installed()
    monkeypatch.setattr(Registry, "build", lambda *_: object())
    with pytest.raises(ConfigError, match="expected one that draws"):
        film(recording, ARM, registry, camera="folder")
