"""The protobuf wire format, as far as EGM's messages use it.

https://protobuf.dev/programming-guides/encoding: a message is a list of (number, type, value).
Fields that are not known are skipped, as newer controllers send some.
"""

from __future__ import annotations

import struct
from collections.abc import Iterator

from clothrf_core.errors import ClothrfError

VARINT, FIXED64, LENGTH, FIXED32 = 0, 1, 2, 5
DOUBLE = struct.Struct("<d")


class BrokenMessage(ClothrfError):
    """Bytes that are no EGM message; they are counted and dropped."""


def fields(data: bytes) -> Iterator[tuple[int, int, int | bytes]]:
    """(number, wire type, value) of every field; 8 and 4 byte values as bytes.

    Raises:
        BrokenMessage: truncated, or a wire type that does not exist.
    """
    at, end = 0, len(data)
    while at < end:
        key = data[at]
        if key < 0x80:
            at += 1
        else:
            key, at = varint(data, at)
        kind = key & 7
        if key >> 3 == 0:
            raise BrokenMessage("expected a field number above 0, found 0")
        if kind == VARINT:
            value, at = varint(data, at)
            yield key >> 3, kind, value
            continue
        if kind == LENGTH:
            size, at = varint(data, at)
        elif kind == FIXED64:
            size = 8
        elif kind == FIXED32:
            size = 4
        else:
            raise BrokenMessage(f"expected wire type 0, 1, 2 or 5, found {kind}")
        if at + size > end:
            raise BrokenMessage(f"expected {size} more bytes, found {end - at}: truncated")
        yield key >> 3, kind, data[at : at + size]
        at += size


def varint(data: bytes, at: int) -> tuple[int, int]:
    """(value, place behind it) of the varint at `at`, taken as unsigned 64 bits."""
    value = 0
    for shift in range(0, 70, 7):
        if at >= len(data):
            raise BrokenMessage("expected the rest of a varint, found the end: truncated")
        byte = data[at]
        at += 1
        value |= (byte & 0x7F) << shift
        if byte < 0x80:
            return value & 0xFFFFFFFFFFFFFFFF, at
    raise BrokenMessage("expected a varint of at most 10 bytes, found a longer one")


def doubles(parts: list[tuple[int, int | bytes]]) -> tuple[float, ...]:
    """Values of a repeated double from its (wire type, value) pairs, packed or not."""
    values: list[float] = []
    for kind, value in parts:
        if not isinstance(value, bytes) or kind == FIXED32 or len(value) % 8:
            raise BrokenMessage("expected doubles, found a field of another type")
        values.extend(x for (x,) in DOUBLE.iter_unpack(value))
    return tuple(values)


def key(number: int, kind: int) -> bytes:
    """The bytes in front of a field's value."""
    return encode_varint(number << 3 | kind)


def encode_varint(value: int) -> bytes:
    """An unsigned varint; negative numbers as 64 bits in two's complement."""
    value &= 0xFFFFFFFFFFFFFFFF
    out = bytearray()
    while value >= 0x80:
        out.append(value & 0x7F | 0x80)
        value >>= 7
    out.append(value)
    return bytes(out)


def number(field: int, value: int) -> bytes:
    """A varint field: integers, enumerations, booleans."""
    return key(field, VARINT) + encode_varint(value)


def message(field: int, body: bytes) -> bytes:
    """A length-delimited field."""
    return key(field, LENGTH) + encode_varint(len(body)) + body


def double(field: int, value: float) -> bytes:
    """A double field."""
    return key(field, FIXED64) + DOUBLE.pack(value)
