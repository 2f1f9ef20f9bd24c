"""The bytes on the wire are exactly ROS 2's, and nothing else is accepted."""

from __future__ import annotations

import numpy as np
import pytest
from clothrf_zenoh import keys, messages
from clothrf_zenoh.attachment import Attachment
from clothrf_zenoh.faults import MalformedMessage
from hypothesis import given, settings
from hypothesis import strategies as st
from hypothesis.extra.numpy import arrays

from clothrf_core.errors import ConfigError

rosbags = pytest.importorskip("rosbags.typesys")

STORE = rosbags.get_typestore(rosbags.Stores.ROS2_JAZZY)
T = STORE.types
NAMES = tuple(f"yumi_joint_{i}_{side}" for side in "lr" for i in (1, 2, 7, 3, 4, 5, 6))
CODEC = messages.JointTrajectoryCodec(NAMES)

numbers = st.floats(allow_nan=True, allow_infinity=True, width=64)
vectors = arrays(np.float64, len(NAMES), elements=numbers)
stamps = st.integers(0, 2**31 * 1_000_000_000 - 1)
texts = st.text(st.characters(min_codepoint=1, codec="utf-8"), max_size=20)
reals = st.floats(-1e300, 1e300)


def oracle_time(stamp_ns, kind="Time"):
    return T[f"builtin_interfaces/msg/{kind}"](*divmod(stamp_ns, 1_000_000_000))


def oracle_header(stamp_ns, frame):
    return T["std_msgs/msg/Header"](oracle_time(stamp_ns), frame)


def oracle_bytes(message):
    return bytes(STORE.serialize_cdr(message, message.__msgtype__))


def oracle_trajectory(stamp_ns, frame, q, qd, due_ns, names=NAMES, accelerations=()):
    point = T["trajectory_msgs/msg/JointTrajectoryPoint"](
        q, qd, np.array(accelerations, float), np.zeros(0), oracle_time(due_ns, "Duration")
    )
    return oracle_bytes(
        T["trajectory_msgs/msg/JointTrajectory"](
            oracle_header(stamp_ns, frame), list(names), [point]
        )
    )


@given(stamps, st.integers(0, 2**32 - 1), vectors, vectors, st.integers(0, 10**12))
@settings(max_examples=200, deadline=None)
def test_a_joint_command_is_byte_identical_to_the_oracle(stamp_ns, epoch, q, qd, due_ns):
    frame = messages.epoch_frame(epoch)

    data = CODEC.encode(stamp_ns, frame, q, qd, due_ns)

    assert data == oracle_trajectory(stamp_ns, frame, q, qd, due_ns)


@given(stamps, st.integers(0, 2**32 - 1), vectors, vectors, st.integers(0, 10**12))
@settings(max_examples=200, deadline=None)
def test_a_joint_command_comes_back_as_it_went(stamp_ns, epoch, q, qd, due_ns):
    frame = messages.epoch_frame(epoch)

    back = CODEC.decode(CODEC.encode(stamp_ns, frame, q, qd, due_ns))

    assert (back.stamp_ns, back.frame_id, back.time_from_start_ns) == (stamp_ns, frame, due_ns)
    assert back.positions.tobytes() == q.tobytes()
    assert back.velocities.tobytes() == qd.tobytes()


@given(st.integers(0, 600))
@settings(max_examples=200, deadline=None)
def test_a_truncated_joint_command_is_refused(size):
    data = CODEC.encode(1, messages.epoch_frame(1), np.zeros(14), np.zeros(14))
    cut = data[: min(size, len(data) - 1)]

    with pytest.raises(MalformedMessage):
        CODEC.decode(cut)


@given(st.integers(0, 563), st.integers(1, 255))
@settings(max_examples=400, deadline=None)
def test_one_changed_byte_is_refused_or_changes_a_value_and_never_crashes(at, flip):
    data = bytearray(CODEC.encode(1, messages.epoch_frame(1), np.zeros(14), np.zeros(14)))
    data[at] ^= flip

    try:
        back = CODEC.decode(bytes(data))
    except MalformedMessage:
        return

    again = CODEC.encode(
        back.stamp_ns, back.frame_id, back.positions, back.velocities, back.time_from_start_ns
    )
    assert again == bytes(data)


@given(st.binary(max_size=700))
@settings(max_examples=500, deadline=None)
def test_no_decoder_crashes_or_hangs_on_any_bytes(data):
    decoders = (
        CODEC.decode,
        messages.decode_pose_array,
        messages.decode_joint_state,
        messages.decode_diagnostics,
        Attachment.decode,
    )
    for payload in (data, b"\x00\x01\x00\x00" + data):
        for decode in decoders:
            try:
                decode(payload)
            except MalformedMessage:
                continue


@pytest.mark.parametrize(
    ("data", "field"),
    [
        (b"", "JointTrajectory.header"),
        (b"\x00\x00\x00\x00" + bytes(560), "JointTrajectory.header"),
        (oracle_trajectory(1, "world", np.zeros(14), np.zeros(14), 0), "header.frame_id"),
        (
            oracle_trajectory(
                1, "epoch-00000001", np.zeros(14), np.zeros(14), 0, names=NAMES[::-1]
            ),
            "joint_names",
        ),
        (oracle_trajectory(1, "epoch-00000001", np.zeros(13), np.zeros(14), 0), "positions"),
        (oracle_trajectory(1, "epoch-00000001", np.zeros(14), np.zeros(0), 0), "velocities"),
        (
            oracle_trajectory(
                1, "epoch-00000001", np.zeros(14), np.zeros(14), 0, accelerations=np.zeros(14)
            ),
            "accelerations",
        ),
    ],
)
def test_a_refusal_names_the_field(data, field):
    with pytest.raises(MalformedMessage, match=field):
        CODEC.decode(data)


def test_a_length_of_four_thousand_million_is_refused_without_making_it():
    data = bytearray(messages.encode_joint_state(messages.JointState(0, "", (), np.zeros(0))))
    data[20:24] = b"\xff\xff\xff\xff"

    with pytest.raises(MalformedMessage, match=r"JointState\.name: expected at most"):
        messages.decode_joint_state(bytes(data))


@given(stamps, texts, st.integers(0, 4), st.data())
@settings(max_examples=100, deadline=None)
def test_pose_arrays_agree_with_the_oracle(stamp_ns, frame, count, data):
    rows = data.draw(arrays(np.float64, (count, 7), elements=reals))
    pose, point, turn = (T[f"geometry_msgs/msg/{k}"] for k in ("Pose", "Point", "Quaternion"))
    oracle = T["geometry_msgs/msg/PoseArray"](
        oracle_header(stamp_ns, frame), [pose(point(*r[:3]), turn(*r[3:])) for r in rows]
    )

    mine = messages.encode_pose_array(messages.PoseArray(stamp_ns, frame, rows[:, :3], rows[:, 3:]))
    back = messages.decode_pose_array(mine)

    assert mine == oracle_bytes(oracle)
    assert np.array_equal(np.hstack([back.positions, back.orientations]), rows)
    assert (back.stamp_ns, back.frame_id) == (stamp_ns, frame)


@given(stamps, texts, st.lists(texts, max_size=5), st.booleans(), st.data())
@settings(max_examples=100, deadline=None)
def test_joint_states_agree_with_the_oracle(stamp_ns, frame, names, with_speed, data):
    q = data.draw(arrays(np.float64, len(names), elements=reals))
    qd = q + 1.0 if with_speed else np.zeros(0)
    oracle = T["sensor_msgs/msg/JointState"](
        oracle_header(stamp_ns, frame), names, q, qd, np.zeros(0)
    )

    mine = messages.encode_joint_state(messages.JointState(stamp_ns, frame, tuple(names), q, qd))
    back = messages.decode_joint_state(mine)

    assert mine == oracle_bytes(oracle)
    assert back.names == tuple(names)
    assert np.array_equal(back.positions, q)
    assert np.array_equal(back.velocities, qd)


@given(
    stamps,
    st.lists(
        st.tuples(
            st.integers(0, 3),
            texts,
            texts,
            texts,
            st.lists(st.tuples(texts, texts), max_size=4).map(tuple),
        ),
        max_size=3,
    ),
)
@settings(max_examples=100, deadline=None)
def test_diagnostics_agree_with_the_oracle(stamp_ns, rows):
    status, pair = (T[f"diagnostic_msgs/msg/{k}"] for k in ("DiagnosticStatus", "KeyValue"))
    oracle = T["diagnostic_msgs/msg/DiagnosticArray"](
        oracle_header(stamp_ns, ""), [status(*r[:4], [pair(*p) for p in r[4]]) for r in rows]
    )
    message = messages.DiagnosticArray(
        stamp_ns, "", tuple(messages.DiagnosticStatus(*r) for r in rows)
    )

    mine = messages.encode_diagnostics(message)

    assert mine == oracle_bytes(oracle)
    assert messages.decode_diagnostics(mine) == message


@given(
    st.integers(-(2**63), 2**63 - 1), st.integers(0, 2**63 - 1), st.binary(min_size=16, max_size=16)
)
def test_an_attachment_has_33_bytes_and_comes_back(sequence, stamp_ns, gid):
    attachment = Attachment(sequence, stamp_ns, gid)

    data = attachment.encode()

    assert len(data) == 33
    assert data[16] == 0x10
    assert Attachment.decode(data) == attachment


@pytest.mark.parametrize("data", [None, b"", bytes(32), bytes(34), bytes(33)])
def test_a_foreign_attachment_is_refused(data):
    with pytest.raises(MalformedMessage, match="attachment"):
        Attachment.decode(data)


@pytest.mark.parametrize(
    "kind",
    [keys.JOINT_TRAJECTORY, keys.POSE_ARRAY, keys.JOINT_STATE, keys.DIAGNOSTIC_ARRAY],
    ids=lambda k: k.name,
)
def test_a_type_hash_is_the_one_ros_computes(kind):
    assert STORE.hash_rihs01(kind.name) == kind.rihs01


def test_a_command_key_is_rmw_zenohs():
    assert keys.Keys("yumi", 7).joint_trajectory.key == (
        "7/yumi/joint_trajectory/trajectory_msgs::msg::dds_::JointTrajectory_/"
        "RIHS01_179b33eba59d676f6d967ac71fe35e7ca2f64b2f3928f4a018cec115e213796e"
    )


def test_a_graph_token_has_the_parts_that_rmw_zenoh_parses():
    token = keys.topic_token(
        keys.Keys("yumi").joint_states, "ab12", "bridge", entity=3, publishes=True
    )

    parts = token.split("/")

    assert len(parts) == 13
    assert parts[:9] == ["@ros2_lv", "0", "ab12", "0", "3", "MP", "%", "%", "bridge"]
    assert parts[9:11] == ["%yumi%joint_states", "sensor_msgs::msg::dds_::JointState_"]


@pytest.mark.parametrize("namespace", ["", "/yumi", "yumi/", "a b", "**", "1arm"])
def test_a_namespace_that_is_no_ros_name_is_refused(namespace):
    with pytest.raises(ConfigError, match="ROS name"):
        keys.Keys(namespace)
