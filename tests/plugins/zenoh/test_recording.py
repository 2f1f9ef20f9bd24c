"""A recording is a file that others can read and that a bridge can be played."""

from __future__ import annotations

import os
import time
from pathlib import Path

import numpy as np
import pytest
from clothrf_zenoh.client import BridgeClient
from clothrf_zenoh.config import ZenohSection
from clothrf_zenoh.keys import Keys
from clothrf_zenoh.messages import JointTrajectoryCodec, epoch_frame
from clothrf_zenoh.record import McapFile, record
from clothrf_zenoh.replay import read_commands, replay
from clothrf_zenoh.schemas import SCHEMAS
from clothrf_zenoh.session import keys_of, open_session

from clothrf_core.clock import WallClock
from clothrf_core.errors import DataError

from .conftest import DT
from .processes import ARM, bridge, drive, free_port, robot

rosbags = pytest.importorskip("rosbags.typesys")
KEYS = Keys("yumi")
MS = 1_000_000


@pytest.fixture
def swing():
    """(times in ns, postures, speeds) of one joint going out and back."""
    limiter = ARM.limiter(DT, q=ARM.ready)
    rows = []
    for i in range(200):
        goal = np.zeros(14)
        goal[3] = 0.3 if i < 100 else 0.0
        rows.append(limiter.tick(goal)[:2])
    q, qd = (np.array(column) for column in zip(*rows, strict=True))
    return np.arange(200) * 4 * MS, q, qd


@pytest.fixture
def recording(tmp_path, swing):
    path = tmp_path / "swing.mcap"
    codec = JointTrajectoryCodec(ARM.joint_names)
    with McapFile(path, KEYS.topics) as file:
        for i, (at, q, qd) in enumerate(zip(*swing, strict=True)):
            data = codec.encode(int(10**18 + at), epoch_frame(3), q, qd)
            file.add(
                KEYS.joint_trajectory,
                data,
                sequence=i + 1,
                stamp_ns=int(10**18 + at),
                received_ns=int(10**18 + at),
            )
    return path


def test_an_independent_reader_decodes_a_recording(recording, swing):
    decoder = pytest.importorskip("mcap_ros2.decoder")
    reader = pytest.importorskip("mcap.reader")

    with recording.open("rb") as file:
        messages = [
            m
            for _, channel, _, m in reader.make_reader(
                file, decoder_factories=[decoder.DecoderFactory()]
            ).iter_decoded_messages()
            if channel.topic == "/yumi/joint_trajectory"
        ]

    assert len(messages) == 200
    assert list(messages[0].joint_names) == list(ARM.joint_names)
    assert np.array_equal([m.points[0].positions for m in messages], swing[1])


@pytest.mark.parametrize("name", SCHEMAS)
def test_a_schema_is_the_one_ros_ships(name):
    store = rosbags.get_typestore(rosbags.Stores.ROS2_JAZZY)

    assert mine(SCHEMAS[name]) == mine(store.generate_msgdef(name, ros_version=2)[0])


def mine(text):
    """Fields of every message in a definition, without spaces, comments and order of messages."""
    blocks = [block.strip().splitlines() for block in text.split("=" * 80)]
    return {
        tuple(line.replace(" ", "") for line in block if line and not line.startswith("#"))
        for block in blocks
    }


def test_commands_come_back_from_a_recording(recording, swing):
    back = read_commands(recording, ARM.joint_names)

    assert np.array_equal(back.times_ns, swing[0])
    assert np.array_equal(back.positions, swing[1])
    assert np.array_equal(back.velocities, swing[2])


def test_a_recording_of_other_arms_is_refused(recording):
    with pytest.raises(DataError, match="joint_names"):
        read_commands(recording, tuple(f"other_{i}" for i in range(14)))


@pytest.mark.parametrize("size", [0, 10, 5000])
def test_a_damaged_recording_is_refused(recording, size):
    recording.write_bytes(recording.read_bytes()[:size])

    with pytest.raises(DataError, match="MCAP"):
        read_commands(recording, ARM.joint_names)


def test_a_recording_without_commands_is_refused(tmp_path):
    with McapFile(tmp_path / "empty.mcap", KEYS.topics):
        pass

    with pytest.raises(DataError, match="expected joint commands"):
        read_commands(tmp_path / "empty.mcap", ARM.joint_names)


def test_an_existing_recording_is_never_overwritten(recording):
    before = recording.read_bytes()

    with pytest.raises(DataError, match="choose another"), McapFile(recording, KEYS.topics):
        pass

    assert recording.read_bytes() == before


def test_a_recording_is_played_into_a_bridge(recording):
    port = free_port()
    section = ZenohSection(connect=[f"tcp/127.0.0.1:{port}"])
    with bridge(port) as far:
        with (
            open_session(section, Path()) as session,
            BridgeClient(session, keys_of(section), os.urandom(16), ARM.joint_names) as client,
        ):
            client.wait_for_bridge(5.0)
            commands = read_commands(recording, ARM.joint_names)
            sent = replay(commands, client, WallClock(), lease_s=2.0)
        time.sleep(0.1)

    assert sent == 200
    assert far.last_status["accepted"] >= 199
    assert far.last_status["lost"] == 0


def test_what_is_on_the_wire_is_recorded(tmp_path):
    port = free_port()
    path = tmp_path / "run.mcap"
    section = ZenohSection(connect=[f"tcp/127.0.0.1:{port}"])
    with bridge(port), robot(port) as machine:
        deadline = time.monotonic() + 1.0
        home = ARM.grasp_points(ARM.ready)

        def stop():
            drive(machine, home, 0.05)
            return time.monotonic() > deadline

        count = record(section, tmp_path, path, WallClock(), stop)

    assert count > 50
    assert len(read_commands(path, ARM.joint_names).times_ns) > 20
    assert [p.name for p in tmp_path.iterdir()] == ["run.mcap"]
