"""The codec against Google's, built from the published field numbers, and against noise."""

from __future__ import annotations

from typing import Any

import numpy as np
import pytest
from clothrf_egm.messages import (
    Motion,
    Motors,
    Rapid,
    RobotMessage,
    SensorMessage,
    decode_robot,
    decode_sensor,
    encode_robot,
    encode_sensor,
)
from clothrf_egm.wire import BrokenMessage, double, message, number
from hypothesis import given, settings
from hypothesis import strategies as st

JOINTS = (1.5, -2.5, 3.25, -179.0, 88.0, -229.0)
ROBOT = RobotMessage(
    sequence=300,
    time_ms=123456,
    joints=JOINTS,
    external=(135.0,),
    motors=Motors.ON,
    motion=Motion.RUNNING,
    rapid=Rapid.RUNNING,
    planned=(*JOINTS, 134.0),
)
SENSOR = SensorMessage(7, 99, JOINTS, (135.0,), (1.0,) * 6, (2.0,))

finite = st.floats(allow_nan=False, allow_infinity=False)
angles = st.tuples(*[finite] * 6)
uint32 = st.integers(0, 2**32 - 1)


def egm_proto() -> dict[str, Any]:
    """EGM's messages as classes of google.protobuf, from their field numbers."""
    pytest.importorskip("google.protobuf")
    from google.protobuf import descriptor_pb2, descriptor_pool, message_factory

    Field = descriptor_pb2.FieldDescriptorProto
    scalar = {"u": Field.TYPE_UINT32, "d": Field.TYPE_DOUBLE, "i": Field.TYPE_INT32}
    scalar["b"] = Field.TYPE_BOOL
    layout: dict[str, list[tuple[str, int, str]]] = {
        "Header": [("seqno", 1, "u"), ("tm", 2, "u"), ("mtype", 3, "i")],
        "Joints": [("joints", 1, "*d")],
        "Feedback": [("joints", 1, "Joints"), ("externalJoints", 3, "Joints")],
        "State": [("state", 1, "i")],
        "SpeedRef": [("joints", 1, "Joints"), ("externalJoints", 3, "Joints")],
        "Robot": [
            ("header", 1, "Header"),
            ("feedBack", 2, "Feedback"),
            ("planned", 3, "Feedback"),
            ("motorState", 4, "State"),
            ("mciState", 5, "State"),
            ("mciConvergenceMet", 6, "b"),
            ("testSignals", 7, "Joints"),
            ("rapidExecState", 8, "State"),
            ("utilizationRate", 10, "d"),
            ("moveIndex", 11, "u"),
        ],
        "Sensor": [
            ("header", 1, "Header"),
            ("planned", 2, "Feedback"),
            ("speedRef", 3, "SpeedRef"),
        ],
    }
    file = descriptor_pb2.FileDescriptorProto(name="egm_test.proto", package="t", syntax="proto2")
    for name, members in layout.items():
        kind = file.message_type.add(name=name)
        for member, tag, what in members:
            repeated = what.startswith("*")
            what = what.lstrip("*")
            field = kind.field.add(name=member, number=tag)
            field.label = Field.LABEL_REPEATED if repeated else Field.LABEL_OPTIONAL
            if what in scalar:
                field.type = scalar[what]
            else:
                field.type, field.type_name = Field.TYPE_MESSAGE, f".t.{what}"
    pool = descriptor_pool.DescriptorPool()
    pool.Add(file)
    return {
        name: message_factory.GetMessageClass(pool.FindMessageTypeByName(f"t.{name}"))
        for name in layout
    }


def test_googles_protobuf_reads_our_answer():
    theirs = egm_proto()["Sensor"].FromString(encode_sensor(SENSOR))

    assert (theirs.header.seqno, theirs.header.tm, theirs.header.mtype) == (7, 99, 3)
    assert tuple(theirs.planned.joints.joints) == SENSOR.joints
    assert tuple(theirs.planned.externalJoints.joints) == SENSOR.external
    assert tuple(theirs.speedRef.joints.joints) == SENSOR.speeds
    assert tuple(theirs.speedRef.externalJoints.joints) == SENSOR.external_speeds
    assert theirs.SerializeToString() == encode_sensor(SENSOR)


def test_we_read_googles_request():
    theirs = egm_proto()["Robot"]()
    theirs.header.seqno, theirs.header.tm, theirs.header.mtype = 300, 123456, 2
    theirs.feedBack.joints.joints.extend(JOINTS)
    theirs.feedBack.externalJoints.joints.append(135.0)
    theirs.planned.joints.joints.extend(JOINTS)
    theirs.planned.externalJoints.joints.append(134.0)
    theirs.motorState.state, theirs.mciState.state, theirs.rapidExecState.state = 1, 3, 2
    theirs.mciConvergenceMet = False
    theirs.testSignals.joints.extend([1.0] * 6)
    theirs.utilizationRate = 12.5
    theirs.moveIndex = 4

    assert decode_robot(theirs.SerializeToString()) == ROBOT


def test_googles_protobuf_reads_our_request():
    theirs = egm_proto()["Robot"].FromString(encode_robot(ROBOT))
    assert tuple(theirs.feedBack.joints.joints) == JOINTS
    assert theirs.motorState.state == 1
    assert theirs.mciState.state == 3
    assert theirs.rapidExecState.state == 2


@given(uint32, uint32, angles, finite, st.booleans())
def test_answers_survive_the_way_there(sequence, time_ms, joints, external, with_speeds):
    speeds = (joints, (external,)) if with_speeds else ((), ())
    sensor = SensorMessage(sequence, time_ms, joints, (external,), *speeds)
    assert decode_sensor(encode_sensor(sensor)) == sensor


@given(uint32, uint32, angles, finite, st.sampled_from(Motors), st.sampled_from(Rapid))
def test_requests_survive_the_way_there(sequence, time_ms, joints, external, motors, rapid):
    robot = RobotMessage(
        sequence, time_ms, joints, (external,), motors, Motion.RUNNING, rapid, (*joints, external)
    )
    assert decode_robot(encode_robot(robot)) == robot


@settings(max_examples=300)
@given(st.binary(max_size=300))
def test_noise_is_a_broken_message_and_nothing_worse(data):
    for decode in (decode_robot, decode_sensor):
        try:
            decode(data)
        except BrokenMessage:
            continue


@settings(max_examples=300)
@given(st.data())
def test_a_request_with_changed_bytes_is_read_or_broken_and_nothing_worse(data):
    raw = bytearray(encode_robot(ROBOT))
    for _ in range(data.draw(st.integers(1, 4))):
        raw[data.draw(st.integers(0, len(raw) - 1))] = data.draw(st.integers(0, 255))
    try:
        robot = decode_robot(bytes(raw))
    except BrokenMessage:
        return
    assert len(robot.joints) == 6


def test_every_truncation_of_an_answer_is_broken_or_lacks_speeds():
    data = encode_sensor(SENSOR)
    for size in range(len(data)):
        try:
            assert decode_sensor(data[:size]).speeds == ()
        except BrokenMessage:
            continue


def test_packed_doubles_are_read_too():
    packed = message(1, np.array(JOINTS).tobytes())
    feedback = message(1, packed) + message(3, message(1, np.array([135.0]).tobytes()))
    header = number(1, 300) + number(2, 123456) + number(3, 2)
    robot = decode_robot(message(1, header) + message(2, feedback))
    assert robot.joints == JOINTS
    assert robot.external == (135.0,)


def test_fields_of_newer_controllers_are_skipped():
    extra = number(11, 3) + message(12, b"\x08\x01") + double(13, 1.0) + message(14, b"abc")
    assert decode_robot(encode_robot(ROBOT) + extra) == ROBOT


def test_states_of_newer_controllers_count_as_undefined():
    data = encode_robot(ROBOT) + message(4, number(1, 77))
    assert decode_robot(data).motors is Motors.UNDEFINED


def test_a_position_answer_is_as_short_as_others_have_it():
    # 75 bytes with protobuf's own encoder for small numbers, without speeds.
    assert len(encode_sensor(SensorMessage(5, 20, JOINTS, (7.0,)))) <= 83


@pytest.mark.parametrize(
    ("data", "words"),
    [
        (b"", "EgmRobot.header.seqno: expected a number, found none"),
        (b"\x0a\x7f", "expected 127 more bytes, found 0: truncated"),
        (b"\x0b", "expected wire type 0, 1, 2 or 5, found 3"),
        (b"\xff" * 12, "expected a varint of at most 10 bytes"),
        (b"\x00\x00", "expected a field number above 0, found 0"),
        (
            message(1, number(1, 5) + number(3, 2)) + message(2, message(1, double(1, 1.0))),
            "EgmRobot.feedBack: expected 6 joints and 1 external joint, found 1 and 0",
        ),
        (message(1, number(1, 5) + number(3, 3)), "EgmRobot.header.mtype: expected 2 (data)"),
    ],
)
def test_a_broken_request_says_what_was_expected(data, words):
    with pytest.raises(BrokenMessage) as caught:
        decode_robot(data)
    assert words in str(caught.value)


@pytest.mark.parametrize(
    ("change", "ready"),
    [
        ({}, True),
        ({"rapid": Rapid.UNDEFINED}, True),  # controllers forget it after a restart
        ({"rapid": Rapid.STOPPED}, False),
        ({"motors": Motors.OFF}, False),
        ({"motors": Motors.UNDEFINED}, False),
        ({"motion": Motion.STOPPED}, False),
        ({"motion": Motion.ERROR}, False),
    ],
)
def test_ready_needs_motors_motion_and_a_program_not_stopped(change, ready):
    from dataclasses import replace

    assert replace(ROBOT, **change).ready is ready
