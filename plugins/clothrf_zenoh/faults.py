"""What can be wrong with a message, a stream or a connection; each error names the fact."""

from __future__ import annotations

from clothrf_core.errors import ClothrfError


class MalformedMessage(ClothrfError):
    """Bytes that are not the message they claim to be.

    Attributes:
        field: which part of the message.
        expected: what should stand there.
        found: what stands there.
    """

    def __init__(self, field: str, *, expected: str, found: str) -> None:
        super().__init__(f"{field}: expected {expected}, found {found}")
        self.field = field
        self.expected = expected
        self.found = found


class BridgeUnreachable(ClothrfError):
    """No bridge answers on the configured address; the message says how to start one."""


class BridgeRefused(ClothrfError):
    """The bridge answered a request with a refusal; the message gives its reason."""


class UnsafeExposure(ClothrfError):
    """An address beyond this machine without any protection; the message lists the remedies."""
