"""Everything on the wire into one MCAP file that Foxglove and ROS 2 tools open as it is."""

from __future__ import annotations

import os
from collections.abc import Callable
from pathlib import Path
from types import TracebackType
from typing import IO, Self

import zenoh
from mcap.writer import CompressionType, Writer

from clothrf_core.clock import Clock
from clothrf_core.errors import DataError
from clothrf_zenoh.attachment import Attachment
from clothrf_zenoh.config import ZenohSection
from clothrf_zenoh.faults import MalformedMessage
from clothrf_zenoh.keys import Topic
from clothrf_zenoh.pace import wall_ns
from clothrf_zenoh.schemas import SCHEMAS
from clothrf_zenoh.session import keys_of, open_session

KEPT = 4096


class McapFile:
    """An MCAP file in the making: ``.NAME.partial`` until it is closed, then NAME.

    Args:
        path: the finished file; an existing one is never overwritten.
        topics: what may be written.
    """

    def __init__(self, path: Path, topics: tuple[Topic, ...]) -> None:
        self._path = path
        self._topics = topics
        self._partial = path.with_name(f".{path.name}.partial")
        self._stream: IO[bytes]

    def __enter__(self) -> Self:
        if self._path.exists():
            raise DataError(f"{self._path}: expected a new file name, found a file; choose another")
        self._stream = self._partial.open("wb")
        self._writer = Writer(self._stream, compression=CompressionType.NONE, chunk_size=256 * 1024)
        self._writer.start(profile="ros2", library="clothrf")
        self._channels = {}
        for topic in self._topics:
            schema = self._writer.register_schema(
                name=topic.type.name, encoding="ros2msg", data=SCHEMAS[topic.type.name].encode()
            )
            self._channels[topic] = self._writer.register_channel(
                topic=f"/{topic.name}",
                message_encoding="cdr",
                schema_id=schema,
                metadata={"rihs01": topic.type.rihs01, "domain": str(topic.domain)},
            )
        return self

    def add(
        self, topic: Topic, payload: bytes, *, sequence: int, stamp_ns: int, received_ns: int
    ) -> None:
        """One message; `stamp_ns` is the sender's wall clock, `received_ns` ours."""
        self._writer.add_message(
            channel_id=self._channels[topic],
            log_time=received_ns,
            publish_time=max(stamp_ns, 0),
            sequence=sequence & 0xFFFFFFFF,
            data=payload,
        )

    def __exit__(
        self,
        kind: type[BaseException] | None,
        error: BaseException | None,
        trace: TracebackType | None,
    ) -> None:
        self._writer.finish()  # type: ignore[no-untyped-call]
        self._stream.flush()
        os.fsync(self._stream.fileno())
        self._stream.close()
        self._partial.replace(self._path)


def record(
    section: ZenohSection, folder: Path, path: Path, clock: Clock, stop: Callable[[], bool]
) -> int:
    """Write all topics of `section` to `path` until `stop`; returns the number of messages.

    Raises:
        DataError: `path` exists.
        ConfigError: the connection's config is wrong.
    """
    keys = keys_of(section)
    count = 0
    with McapFile(path, keys.topics) as file, open_session(section, folder) as session:
        rings = [
            (
                topic,
                session.declare_subscriber(
                    topic.any_distribution, zenoh.handlers.RingChannel(KEPT)
                ),
            )
            for topic in keys.topics
        ]
        while not stop():
            clock.sleep_until_ns(clock.now_ns() + 20_000_000)
            for topic, ring in rings:
                while (sample := ring.try_recv()) is not None:
                    received = wall_ns()
                    try:
                        data = sample.attachment
                        sender = Attachment.decode(None if data is None else data.to_bytes())
                    except MalformedMessage:
                        sender = Attachment(0, received, bytes(16))
                    file.add(
                        topic,
                        sample.payload.to_bytes(),
                        sequence=sender.sequence,
                        stamp_ns=sender.stamp_ns,
                        received_ns=received,
                    )
                    count += 1
        for _, ring in rings:
            ring.undeclare()  # type: ignore[no-untyped-call]
    return count
