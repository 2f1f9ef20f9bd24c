"""The four ROS 2 messages that cross the wire, as nouns with an exact, strict codec each.

`JointTrajectoryCodec` is the hot path: names and lengths are fixed when the stream is made, so
encoding fills a template and decoding compares slices. Bytes that do not fit the template are read
again by the slow strict reader, only to say which field is wrong. The bytes are those that any
ROS 2 node would write (tests compare them with an independent implementation).
"""

from __future__ import annotations

import struct
from dataclasses import dataclass, field

import numpy as np

from clothrf_core.types import Float
from clothrf_zenoh.cdr import HEADER, Reader, Writer
from clothrf_zenoh.faults import MalformedMessage

_STAMP = struct.Struct("<iI")
_BILLION = 1_000_000_000


def _no_floats() -> Float:
    return np.zeros(0)


@dataclass(frozen=True, slots=True, eq=False)
class JointTrajectory:
    """`trajectory_msgs/JointTrajectory` with one point: the joint command.

    Attributes:
        stamp_ns: header stamp.
        frame_id: names the epoch the command belongs to, see `epoch_frame`.
        positions: (J,) float64, rad.
        velocities: (J,) float64, rad/s.
        time_from_start_ns: when the point is due after the stamp.
    """

    stamp_ns: int
    frame_id: str
    positions: Float
    velocities: Float
    time_from_start_ns: int = 0


@dataclass(frozen=True, slots=True, eq=False)
class PoseArray:
    """`geometry_msgs/PoseArray`: gripper targets.

    Attributes:
        stamp_ns: header stamp.
        frame_id: frame of the poses.
        positions: (N, 3) float64, metres.
        orientations: (N, 4) float64 quaternions x, y, z, w.
    """

    stamp_ns: int
    frame_id: str
    positions: Float
    orientations: Float


@dataclass(frozen=True, slots=True, eq=False)
class JointState:
    """`sensor_msgs/JointState`: what the joints do.

    Attributes:
        stamp_ns: header stamp.
        frame_id: free text; the bridge writes its state here.
        names: J joint names.
        positions: (J,) float64, rad.
        velocities: (J,) or (0,) float64, rad/s.
        efforts: (J,) or (0,) float64.
    """

    stamp_ns: int
    frame_id: str
    names: tuple[str, ...]
    positions: Float
    velocities: Float = field(default_factory=_no_floats)
    efforts: Float = field(default_factory=_no_floats)


@dataclass(frozen=True, slots=True)
class DiagnosticStatus:
    """`diagnostic_msgs/DiagnosticStatus`; level 0 OK, 1 WARN, 2 ERROR, 3 STALE."""

    level: int
    name: str
    message: str
    hardware_id: str
    values: tuple[tuple[str, str], ...] = ()


@dataclass(frozen=True, slots=True)
class DiagnosticArray:
    """`diagnostic_msgs/DiagnosticArray`: how the bridge is."""

    stamp_ns: int
    frame_id: str
    statuses: tuple[DiagnosticStatus, ...]


def epoch_frame(epoch: int) -> str:
    """The 14-character frame id that ties a command to the arm grant `epoch`."""
    return f"epoch-{epoch:08x}"


class JointTrajectoryCodec:
    """Encodes and decodes joint commands for one fixed list of joints.

    Args:
        names: the J joint names, in the order of every vector.
        frame_size: characters of `frame_id`; fixed, so that every field has a fixed place.
    """

    def __init__(self, names: tuple[str, ...], frame_size: int = len(epoch_frame(0))) -> None:
        self.names = names
        zeros = np.zeros(len(names))
        writer = Writer()
        writer.stamp(0)
        writer.string("x" * frame_size)
        self._frame = (writer.size - 1 - frame_size, writer.size - 1)
        writer.u32(len(names))
        for name in names:
            writer.string(name)
        writer.u32(1)
        writer.double_sequence(zeros)
        self._q = writer.size - 8 * len(names)
        writer.double_sequence(zeros)
        self._qd = writer.size - 8 * len(names)
        writer.double_sequence(_no_floats())
        writer.double_sequence(_no_floats())
        self._due = writer.size
        writer.stamp(0)
        self._template = bytes(writer)
        self._block = struct.Struct(f"<{len(names)}d")
        # Everything between the variable fields must be there, byte for byte.
        edges = [
            (0, len(HEADER)),
            (len(HEADER) + 8, self._frame[0]),
            (self._frame[1], self._q),
            (self._q + 8 * len(names), self._qd),
            (self._qd + 8 * len(names), self._due),
        ]
        self._fixed = tuple((a, b, self._template[a:b]) for a, b in edges)

    @property
    def size(self) -> int:
        """Bytes of every message."""
        return len(self._template)

    def encode(
        self,
        stamp_ns: int,
        frame_id: str,
        positions: Float,
        velocities: Float,
        time_from_start_ns: int = 0,
    ) -> bytes:
        """The message's bytes.

        Args:
            stamp_ns: header stamp.
            frame_id: as many ASCII characters as the codec was made for.
            positions: (J,) float64, rad.
            velocities: (J,) float64, rad/s.
            time_from_start_ns: when the point is due after the stamp.
        """
        data = bytearray(self._template)
        _STAMP.pack_into(data, 4, *divmod(stamp_ns, _BILLION))
        data[self._frame[0] : self._frame[1]] = frame_id.encode("ascii")
        if len(data) != len(self._template):
            size = self._frame[1] - self._frame[0]
            raise MalformedMessage(
                "JointTrajectory.frame_id", expected=f"{size} characters", found=repr(frame_id)
            )
        self._block.pack_into(data, self._q, *positions)
        self._block.pack_into(data, self._qd, *velocities)
        _STAMP.pack_into(data, self._due, *divmod(time_from_start_ns, _BILLION))
        return bytes(data)

    def decode(self, data: bytes) -> JointTrajectory:
        """The command in `data`; numbers may still be NaN, which is for `checks` to refuse.

        Raises:
            MalformedMessage: any byte is not where the template has it; names the field.
        """
        if len(data) != len(self._template):
            raise self._diagnosis(data)
        for start, stop, wanted in self._fixed:
            if data[start:stop] != wanted:
                raise self._diagnosis(data)
        seconds, nanoseconds = _STAMP.unpack_from(data, 4)
        due_s, due_ns = _STAMP.unpack_from(data, self._due)
        frame = data[self._frame[0] : self._frame[1]]
        if nanoseconds >= _BILLION or due_ns >= _BILLION or not frame.isascii() or 0 in frame:
            raise self._diagnosis(data)
        # Both vectors with the length field between them, copied to aligned memory at once.
        count = len(self.names)
        both = np.frombuffer(data, "<f8", 2 * count + 1, self._q).copy()
        return JointTrajectory(
            stamp_ns=seconds * _BILLION + nanoseconds,
            frame_id=frame.decode("ascii"),
            positions=both[:count],
            velocities=both[count + 1 :],
            time_from_start_ns=due_s * _BILLION + due_ns,
        )

    def _diagnosis(self, data: bytes) -> MalformedMessage:
        try:
            reader = Reader(data, "JointTrajectory")
            reader.stamp("header.stamp")
            frame = reader.string("header.frame_id")
            size = self._frame[1] - self._frame[0]
            if len(frame) != size or not frame.isascii():
                raise reader.refuse(
                    "header.frame_id", expected=f"{size} ASCII characters", found=repr(frame[:40])
                )
            names = tuple(
                reader.string(f"joint_names[{i}]") for i in range(reader.count("joint_names", 4))
            )
            if names != self.names:
                raise reader.refuse("joint_names", expected=str(self.names), found=str(names)[:400])
            points = reader.count("points", 24)
            if points != 1:
                raise reader.refuse("points", expected="1 point", found=str(points))
            for part, wanted in (
                ("positions", len(names)),
                ("velocities", len(names)),
                ("accelerations", 0),
                ("effort", 0),
            ):
                found = len(reader.double_sequence(f"points[0].{part}"))
                if found != wanted:
                    raise reader.refuse(
                        f"points[0].{part}", expected=f"{wanted} numbers", found=str(found)
                    )
            reader.stamp("points[0].time_from_start")
            reader.end()
        except MalformedMessage as error:
            return error
        return MalformedMessage(
            "JointTrajectory", expected=f"{self.size} bytes of one layout", found=f"{len(data)}"
        )


def encode_pose_array(message: PoseArray) -> bytes:
    """Bytes of a `geometry_msgs/PoseArray`."""
    writer = Writer()
    writer.stamp(message.stamp_ns)
    writer.string(message.frame_id)
    writer.u32(len(message.positions))
    writer.doubles(np.hstack([message.positions, message.orientations]).ravel())
    return bytes(writer)


def decode_pose_array(data: bytes) -> PoseArray:
    """The poses in `data`.

    Raises:
        MalformedMessage: naming the field.
    """
    reader = Reader(data, "PoseArray")
    stamp_ns = reader.stamp("header.stamp")
    frame_id = reader.string("header.frame_id")
    count = reader.count("poses", 56)
    rows = reader.doubles("poses", 7 * count).reshape(count, 7)
    reader.end()
    return PoseArray(stamp_ns, frame_id, rows[:, :3].copy(), rows[:, 3:].copy())


def encode_joint_state(message: JointState) -> bytes:
    """Bytes of a `sensor_msgs/JointState`."""
    writer = Writer()
    writer.stamp(message.stamp_ns)
    writer.string(message.frame_id)
    writer.u32(len(message.names))
    for name in message.names:
        writer.string(name)
    for values in (message.positions, message.velocities, message.efforts):
        writer.double_sequence(values)
    return bytes(writer)


def decode_joint_state(data: bytes) -> JointState:
    """The joint state in `data`; every given vector is as long as the names.

    Raises:
        MalformedMessage: naming the field.
    """
    reader = Reader(data, "JointState")
    stamp_ns = reader.stamp("header.stamp")
    frame_id = reader.string("header.frame_id")
    names = tuple(reader.string(f"name[{i}]") for i in range(reader.count("name", 4)))
    vectors = {part: reader.double_sequence(part) for part in ("position", "velocity", "effort")}
    reader.end()
    for part, values in vectors.items():
        if len(values) not in (0, len(names)):
            raise reader.refuse(part, expected=f"0 or {len(names)} numbers", found=str(len(values)))
    return JointState(stamp_ns, frame_id, names, *vectors.values())


def encode_diagnostics(message: DiagnosticArray) -> bytes:
    """Bytes of a `diagnostic_msgs/DiagnosticArray`."""
    writer = Writer()
    writer.stamp(message.stamp_ns)
    writer.string(message.frame_id)
    writer.u32(len(message.statuses))
    for status in message.statuses:
        writer.byte(status.level)
        for text in (status.name, status.message, status.hardware_id):
            writer.string(text)
        writer.u32(len(status.values))
        for key, value in status.values:
            writer.string(key)
            writer.string(value)
    return bytes(writer)


def decode_diagnostics(data: bytes) -> DiagnosticArray:
    """The statuses in `data`.

    Raises:
        MalformedMessage: naming the field.
    """
    reader = Reader(data, "DiagnosticArray")
    stamp_ns = reader.stamp("header.stamp")
    frame_id = reader.string("header.frame_id")
    statuses = []
    for i in range(reader.count("status", 17)):
        level = reader.byte(f"status[{i}].level")
        name = reader.string(f"status[{i}].name")
        text = reader.string(f"status[{i}].message")
        hardware = reader.string(f"status[{i}].hardware_id")
        pairs = tuple(
            (reader.string(f"status[{i}].values[{k}].key"), reader.string(f"values[{k}].value"))
            for k in range(reader.count(f"status[{i}].values", 8))
        )
        statuses.append(DiagnosticStatus(level, name, text, hardware, pairs))
    reader.end()
    return DiagnosticArray(stamp_ns, frame_id, tuple(statuses))
