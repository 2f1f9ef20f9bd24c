"""EGM's two messages: `EgmRobot` from the controller and `EgmSensor` to it.

Field numbers of ABB's egm.proto (protocol 1.1; RobotWare 6 and 7 agree in all fields used here).
Angles are in degrees as on the wire; `mapping.py` turns them. proto2 writes repeated doubles one by
one; both forms are read.
"""

from __future__ import annotations

import enum
from dataclasses import dataclass
from typing import TypeVar

from clothrf_egm.wire import (
    LENGTH,
    VARINT,
    BrokenMessage,
    double,
    doubles,
    fields,
    message,
    number,
)

StateT = TypeVar("StateT", bound=enum.IntEnum)

AXES = 6  # joints of the mechanical unit; axis 7 comes as an external joint
DATA, CORRECTION = 2, 3  # EgmHeader.MessageType


class Motors(enum.IntEnum):
    """EgmMotorState."""

    UNDEFINED = 0
    ON = 1
    OFF = 2


class Motion(enum.IntEnum):
    """EgmMCIState."""

    UNDEFINED = 0
    ERROR = 1
    STOPPED = 2
    RUNNING = 3


class Rapid(enum.IntEnum):
    """EgmRapidCtrlExecState."""

    UNDEFINED = 0
    STOPPED = 1
    RUNNING = 2


@dataclass(frozen=True, slots=True)
class RobotMessage:
    """What the controller says.

    Attributes:
        sequence: counts up by one a message; 0 starts a new session.
        time_ms: the controller's clock.
        joints: axes 1 to 6, degrees.
        external: axis 7, degrees.
        planned: the controller's own planned axes 1 to 6 and 7, degrees; empty if not sent.
        motors: are they on?
        motion: does the motion interface run?
        rapid: does the program run? Controllers say UNDEFINED after a restart.
    """

    sequence: int
    time_ms: int
    joints: tuple[float, ...]
    external: tuple[float, ...]
    motors: Motors = Motors.UNDEFINED
    motion: Motion = Motion.UNDEFINED
    rapid: Rapid = Rapid.UNDEFINED
    planned: tuple[float, ...] = ()

    @property
    def ready(self) -> bool:
        """The arm would follow."""
        return (
            self.motors == Motors.ON
            and self.motion == Motion.RUNNING
            and self.rapid != Rapid.STOPPED
        )


@dataclass(frozen=True, slots=True)
class SensorMessage:
    """What the controller is told.

    Attributes:
        sequence: counts up by one a message.
        time_ms: the sender's clock.
        joints: axes 1 to 6, degrees.
        external: axis 7, degrees.
        speeds: speed reference of axes 1 to 6, degrees a second; empty = none is sent.
        external_speeds: of axis 7.
    """

    sequence: int
    time_ms: int
    joints: tuple[float, ...]
    external: tuple[float, ...]
    speeds: tuple[float, ...] = ()
    external_speeds: tuple[float, ...] = ()


def decode_robot(data: bytes) -> RobotMessage:
    """Read an `EgmRobot`.

    Raises:
        BrokenMessage: no protobuf, or without sequence number or joint feedback.
    """
    sequence = time_ms = None
    joints: tuple[float, ...] = ()
    external: tuple[float, ...] = ()
    planned: tuple[float, ...] = ()
    motors = motion = rapid = 0
    for field, kind, value in fields(data):
        if kind != LENGTH or not isinstance(value, bytes):
            continue
        if field == 1:
            header = _numbers(value)
            sequence, time_ms = header.get(1), header.get(2)
            if header.get(3, DATA) != DATA:
                raise BrokenMessage(
                    f"EgmRobot.header.mtype: expected {DATA} (data), found {header.get(3)}"
                )
        elif field == 2:
            joints, external = _positions(value)
        elif field == 3:
            planned = sum(_positions(value), ())
        elif field == 4:
            motors = _numbers(value).get(1, 0)
        elif field == 5:
            motion = _numbers(value).get(1, 0)
        elif field == 8:
            rapid = _numbers(value).get(1, 0)
    if sequence is None:
        raise BrokenMessage("EgmRobot.header.seqno: expected a number, found none")
    if len(joints) != AXES or len(external) != 1:
        raise BrokenMessage(
            f"EgmRobot.feedBack: expected {AXES} joints and 1 external joint, found {len(joints)} "
            f"and {len(external)}"
        )
    return RobotMessage(
        sequence=sequence & 0xFFFFFFFF,
        time_ms=(time_ms or 0) & 0xFFFFFFFF,
        joints=joints,
        external=external,
        motors=_state(Motors, motors),
        motion=_state(Motion, motion),
        rapid=_state(Rapid, rapid),
        planned=planned,
    )


def encode_robot(robot: RobotMessage) -> bytes:
    """Write an `EgmRobot`, as a controller does; for the simulated one."""
    feedback = _joints(1, robot.joints) + _joints(3, robot.external)
    planned = robot.planned or (*robot.joints, *robot.external)
    plan = _joints(1, planned[:AXES]) + _joints(3, planned[AXES:])
    return b"".join(
        (
            message(1, _header(robot.sequence, robot.time_ms, DATA)),
            message(2, feedback),
            message(3, plan),
            message(4, number(1, robot.motors)),
            message(5, number(1, robot.motion)),
            number(6, 0),
            message(8, number(1, robot.rapid)),
            double(10, 0.0),
        )
    )


def encode_sensor(sensor: SensorMessage) -> bytes:
    """Write an `EgmSensor`."""
    planned = _joints(1, sensor.joints) + _joints(3, sensor.external)
    data = message(1, _header(sensor.sequence, sensor.time_ms, CORRECTION)) + message(2, planned)
    if sensor.speeds:
        data += message(3, _joints(1, sensor.speeds) + _joints(3, sensor.external_speeds))
    return data


def decode_sensor(data: bytes) -> SensorMessage:
    """Read an `EgmSensor`; for the simulated controller.

    Raises:
        BrokenMessage: no protobuf, another message, or without joints.
    """
    header: dict[int, int] = {}
    joints: tuple[float, ...] = ()
    external: tuple[float, ...] = ()
    speeds: tuple[float, ...] = ()
    external_speeds: tuple[float, ...] = ()
    for field, kind, value in fields(data):
        if kind != LENGTH or not isinstance(value, bytes):
            continue
        if field == 1:
            header = _numbers(value)
        elif field == 2:
            joints, external = _positions(value)
        elif field == 3:
            speeds, external_speeds = _positions(value)
    if header.get(3) != CORRECTION:
        raise BrokenMessage(
            f"EgmSensor.header.mtype: expected {CORRECTION} (correction), found {header.get(3)}"
        )
    if len(joints) != AXES or len(external) != 1:
        raise BrokenMessage(
            f"EgmSensor.planned: expected {AXES} joints and 1 external joint, found "
            f"{len(joints)} and {len(external)}"
        )
    return SensorMessage(
        sequence=header.get(1, 0),
        time_ms=header.get(2, 0),
        joints=joints,
        external=external,
        speeds=speeds,
        external_speeds=external_speeds,
    )


def _header(sequence: int, time_ms: int, kind: int) -> bytes:
    return number(1, sequence) + number(2, time_ms) + number(3, kind)


def _joints(field: int, values: tuple[float, ...]) -> bytes:
    return message(field, b"".join(double(1, value) for value in values))


def _numbers(data: bytes) -> dict[int, int]:
    return {
        field: value
        for field, kind, value in fields(data)
        if kind == VARINT and isinstance(value, int)
    }


def _positions(data: bytes) -> tuple[tuple[float, ...], tuple[float, ...]]:
    """Joints and external joints of an EgmFeedBack, EgmPlanned or EgmSpeedRef."""
    found: dict[int, tuple[float, ...]] = {1: (), 3: ()}
    for field, kind, value in fields(data):
        if field in found and kind == LENGTH and isinstance(value, bytes):
            found[field] = doubles([(k, v) for f, k, v in fields(value) if f == 1])
    return found[1], found[3]


def _state(states: type[StateT], value: int) -> StateT:
    try:
        return states(value)
    except ValueError:
        return states(0)  # a state that newer controllers know
