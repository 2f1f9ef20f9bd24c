"""CDR, little endian: the bytes of ROS 2 messages, read strictly.

A CDR stream is a 4-byte encapsulation header (00 01 00 00 = little endian) and fields one after
the other, each aligned to its own size counted from the end of the header (OMG formal/2002-06-51
section 15.3; DDS-XTypes 1.3 section 7.4.1). Strings are a uint32 length with the closing zero byte,
the characters and that zero; sequences are a uint32 count and the elements.

`Reader` never trusts a length: one that reaches past the end is refused before anything is made.
"""

from __future__ import annotations

import struct

import numpy as np

from clothrf_core.types import Float
from clothrf_zenoh.faults import MalformedMessage

HEADER = b"\x00\x01\x00\x00"

_U32 = struct.Struct("<I")
_I32 = struct.Struct("<i")


class Writer:
    """Appends fields with their alignment."""

    def __init__(self) -> None:
        self._bytes = bytearray(HEADER)

    def __bytes__(self) -> bytes:
        return bytes(self._bytes)

    @property
    def size(self) -> int:
        """Bytes written so far, header included: the offset of the next unaligned field."""
        return len(self._bytes)

    def align(self, width: int) -> None:
        """Pad with zeros to a multiple of `width` after the header."""
        self._bytes += bytes(-(len(self._bytes) - len(HEADER)) % width)

    def byte(self, value: int) -> None:
        """One octet."""
        self._bytes.append(value)

    def u32(self, value: int) -> None:
        """An unsigned 32-bit number or a count."""
        self.align(4)
        self._bytes += _U32.pack(value)

    def stamp(self, stamp_ns: int) -> None:
        """`builtin_interfaces/Time` or `Duration`: int32 seconds, uint32 nanoseconds."""
        seconds, nanoseconds = divmod(stamp_ns, 1_000_000_000)
        self.align(4)
        self._bytes += _I32.pack(seconds) + _U32.pack(nanoseconds)

    def string(self, text: str) -> None:
        """A UTF-8 string with its length and closing zero."""
        data = text.encode()
        self.u32(len(data) + 1)
        self._bytes += data + b"\x00"

    def doubles(self, values: Float) -> None:
        """Bare float64 numbers; nothing is written, not even padding, for none."""
        if len(values):
            self.align(8)
            self._bytes += np.ascontiguousarray(values, "<f8").tobytes()

    def double_sequence(self, values: Float) -> None:
        """A counted sequence of float64."""
        self.u32(len(values))
        self.doubles(values)


class Reader:
    """Takes fields one after the other; every refusal names the field.

    Args:
        data: the whole message with its header.
        what: name of the message for errors, for example ``"JointState"``.
    """

    def __init__(self, data: bytes, what: str) -> None:
        self._data = data
        self._what = what
        self._at = len(HEADER)
        if data[:4] != HEADER:
            found = data[:4].hex(" ") if data else "nothing"
            raise MalformedMessage(f"{what}.header", expected=HEADER.hex(" "), found=found)

    def refuse(self, field: str, *, expected: str, found: str) -> MalformedMessage:
        """The error to raise for a field of this message."""
        return MalformedMessage(f"{self._what}.{field}", expected=expected, found=found)

    def _take(self, field: str, size: int, width: int) -> bytes:
        start = self._at + -(self._at - len(HEADER)) % width
        stop = start + size
        if stop > len(self._data):
            raise self.refuse(
                field, expected=f"{size} bytes at {start}", found=f"{len(self._data)} bytes in all"
            )
        if any(self._data[self._at : start]):
            raise self.refuse(field, expected="zero padding", found="other bytes")
        self._at = stop
        return self._data[start:stop]

    def byte(self, field: str) -> int:
        """One octet."""
        return self._take(field, 1, 1)[0]

    def count(self, field: str, least_size: int = 1) -> int:
        """A sequence's length, refused if so many elements of `least_size` bytes cannot follow."""
        number = int(_U32.unpack(self._take(field, 4, 4))[0])
        room = len(self._data) - self._at
        if number * least_size > room:
            raise self.refuse(
                field, expected=f"at most {room // least_size} elements", found=str(number)
            )
        return number

    def stamp(self, field: str) -> int:
        """Nanoseconds of a `Time` or `Duration`."""
        seconds, nanoseconds = struct.unpack("<iI", self._take(field, 8, 4))
        if nanoseconds >= 1_000_000_000:
            raise self.refuse(field, expected="nanosec < 10^9", found=str(nanoseconds))
        return int(seconds) * 1_000_000_000 + int(nanoseconds)

    def string(self, field: str) -> str:
        """A UTF-8 string."""
        size = self.count(field)
        data = self._take(field, size, 1)
        if not data or data[-1] or 0 in data[:-1]:
            raise self.refuse(field, expected="a string closed by one zero", found=repr(data[-8:]))
        try:
            return data[:-1].decode()
        except UnicodeDecodeError as error:
            raise self.refuse(field, expected="UTF-8", found=repr(data[:16])) from error

    def doubles(self, field: str, number: int) -> Float:
        """(number,) float64; no padding is expected before an empty run."""
        if number == 0:
            return np.zeros(0)
        return np.frombuffer(self._take(field, 8 * number, 8), "<f8").astype(np.float64)

    def double_sequence(self, field: str) -> Float:
        """A counted sequence of float64."""
        return self.doubles(field, self.count(field, 8))

    def end(self) -> None:
        """Nothing may follow but padding of fewer than four zero bytes."""
        rest = self._data[self._at :]
        if len(rest) > 3 or any(rest):
            raise self.refuse("end", expected="no further bytes", found=f"{len(rest)} bytes")
