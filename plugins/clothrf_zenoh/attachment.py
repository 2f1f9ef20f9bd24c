"""The 33 bytes that rmw_zenoh fastens to every message: sequence, source time, publisher id.

Layout: int64 sequence (from 1), int64 source time in ns since 1970, one byte 0x10, 16-byte gid;
little endian. It gives the bridge order, age and identity of a command without a field of its own.
"""

from __future__ import annotations

import struct
from dataclasses import dataclass

from clothrf_zenoh.faults import MalformedMessage

_LAYOUT = struct.Struct("<qqB16s")
SIZE = _LAYOUT.size
GID_SIZE = 16


@dataclass(frozen=True, slots=True)
class Attachment:
    """Who sent a message, as which one, and when.

    Attributes:
        sequence: counts up by one for each message of a publisher, from 1.
        stamp_ns: the publisher's wall clock, ns since 1970.
        gid: 16 bytes that name the publisher.
    """

    sequence: int
    stamp_ns: int
    gid: bytes

    def encode(self) -> bytes:
        """The 33 bytes."""
        return _LAYOUT.pack(self.sequence, self.stamp_ns, GID_SIZE, self.gid)

    @staticmethod
    def decode(data: bytes | None) -> Attachment:
        """The attachment in `data`.

        Raises:
            MalformedMessage: missing, of another length, or with another gid size.
        """
        if data is None or len(data) != SIZE:
            found = "none" if data is None else f"{len(data)} bytes"
            raise MalformedMessage("attachment", expected=f"{SIZE} bytes", found=found)
        sequence, stamp_ns, size, gid = _LAYOUT.unpack(data)
        if size != GID_SIZE:
            raise MalformedMessage("attachment.gid", expected=f"size {GID_SIZE}", found=str(size))
        return Attachment(sequence, stamp_ns, gid)
