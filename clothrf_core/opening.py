"""What it means to open a thing: pass it on to the camera inside, or nothing at all."""

from __future__ import annotations

from types import TracebackType
from typing import Self

from typing_extensions import override

from clothrf_core.interfaces import Camera


class NothingToOpen:
    """A context manager without effect, for components that hold nothing."""

    def __enter__(self) -> Self:
        return self

    def __exit__(
        self,
        kind: type[BaseException] | None,
        error: BaseException | None,
        trace: TracebackType | None,
    ) -> None:
        return None


class CameraAround(Camera):
    """A camera around another one, opened and closed with it; `read` is left to be written.

    Args:
        inner: the camera inside.
    """

    def __init__(self, inner: Camera) -> None:
        self.__inner = inner

    @override
    def __enter__(self) -> Self:
        self.__inner.__enter__()
        return self

    @override
    def __exit__(
        self,
        kind: type[BaseException] | None,
        error: BaseException | None,
        trace: TracebackType | None,
    ) -> None:
        self.__inner.__exit__(kind, error, trace)
