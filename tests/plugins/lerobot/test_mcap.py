"""The MCAP holds standard ROS 2 messages: read back by a library that knows them by heart."""

import numpy as np
import pytest
from clothrf_lerobot.source import open_source

from clothrf_core.dataset import read_rollout
from clothrf_core.errors import DataError
from clothrf_core.registry import Registry

pytest.importorskip("mcap_ros2")
rosbags = pytest.importorskip("rosbags.typesys")

from clothrf_lerobot import rosbag  # noqa: E402
from mcap.reader import make_reader  # noqa: E402


def messages(path):
    """(topic, type, log time, message) with ROS 2 Humble's own definitions of the types."""
    store = rosbags.get_typestore(rosbags.Stores.ROS2_HUMBLE)
    with path.open("rb") as stream:
        return [
            (channel.topic, schema.name, m.log_time, store.deserialize_cdr(m.data, schema.name))
            for schema, channel, m in make_reader(stream).iter_messages()
        ]


@pytest.fixture
def bag(dataset, tmp_path):
    path = tmp_path / "cloth.mcap"
    registry = Registry.of()
    assert rosbag.export(open_source(dataset.folder, registry, 10.0), registry, path) == 4
    return path


def test_every_point_is_there_bit_for_bit(dataset, bag):
    rollouts = [read_rollout(p) for k in ("heldout", "iteration") for p in dataset.paths(kind=k)]
    wanted = {
        "/clothrf/grasp": [r.grasps for r in rollouts],
        "/clothrf/wanted/straight": [r.labels[:, 0] for r in rollouts],
        "/clothrf/wanted/bent": [r.labels[:, 1] for r in rollouts],
        "/clothrf/sent": [r.executed for r in rollouts],
        "/clothrf/hands": [r.hands for r in rollouts],
    }
    found = {topic: [] for topic in wanted}
    for topic, kind, _, message in messages(bag):
        assert kind == "geometry_msgs/msg/PoseArray"
        assert message.header.frame_id == "world"
        points = [(p.position.x, p.position.y, p.position.z) for p in message.poses]
        found[topic].append(points)
    for topic, arrays in wanted.items():
        assert np.array_equal(np.array(found[topic]), np.concatenate(arrays))


def test_time_runs_on_with_a_second_between_rollouts(bag):
    stamps = [m.header.stamp for topic, _, _, m in messages(bag) if topic == "/clothrf/grasp"]
    times = [s.sec + 1e-9 * s.nanosec for s in stamps]
    steps = np.diff(times)
    assert np.allclose(np.delete(steps, [3, 9, 14]), 0.1)
    assert np.allclose(steps[[3, 9, 14]], 1.0)


def test_log_time_is_the_stamp(bag):
    for _, _, log_time, message in messages(bag):
        stamp = message.header.stamp
        assert log_time == stamp.sec * 1_000_000_000 + stamp.nanosec


def test_pictures_are_standard_images(run, toy, tmp_path):
    path = tmp_path / "cloth.mcap"
    source = open_source(run.path, toy, None)
    rosbag.export(source, toy, path, pictures=True)
    found = messages(path)
    colour = [m for topic, _, _, m in found if topic == "/clothrf/camera/image"]
    depth = [m for topic, _, _, m in found if topic == "/clothrf/camera/depth"]
    info = [m for topic, _, _, m in found if topic == "/clothrf/camera/info"]
    assert len(colour) == len(depth) == len(info) == 6 + 6 + 8 + 8
    assert (colour[0].encoding, colour[0].step, len(colour[0].data)) == ("rgb8", 240, 80 * 60 * 3)
    metres = depth[0].data.view("<f4").reshape(60, 80)
    assert depth[0].encoding == "32FC1"
    assert 0.1 < np.nanmin(metres) < np.nanmax(metres) < 3.0
    assert np.isnan(metres).any()
    assert np.array_equal(info[0].k, [60.0, 0.0, 39.5, 0.0, 60.0, 29.5, 0.0, 0.0, 1.0])


def test_an_existing_file_is_not_replaced(dataset, bag):
    before = bag.read_bytes()
    with pytest.raises(DataError, match="choose another"):
        rosbag.export(open_source(dataset.folder, Registry.of(), 10.0), Registry.of(), bag)
    assert bag.read_bytes() == before


def test_a_failed_export_leaves_nothing(dataset, tmp_path):
    def stop():
        raise KeyboardInterrupt

    path = tmp_path / "other.mcap"
    source = open_source(dataset.folder, Registry.of(), 10.0)
    with pytest.raises(KeyboardInterrupt):
        rosbag.export(source, Registry.of(), path, on_episode=stop)
    assert [p.name for p in tmp_path.iterdir()] == ["dataset"]
