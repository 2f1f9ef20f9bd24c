"""A bridge in a process of its own, for programs that bring up everything together."""

from __future__ import annotations

import multiprocessing
import signal
from collections.abc import Callable, Mapping
from multiprocessing.connection import Connection
from multiprocessing.process import BaseProcess
from pathlib import Path
from types import TracebackType
from typing import Any, Self

from clothrf_core.clock import WallClock
from clothrf_core.errors import ClothrfError
from clothrf_core.registry import Registry
from clothrf_zenoh.compose import resolve_bridge
from clothrf_zenoh.faults import BridgeUnreachable
from clothrf_zenoh.serve import serve

START_TIMEOUT_S = 30.0


class BridgeProcess:
    """`clothrf bridge` as a context manager: leaves when the block ends, arms at rest.

    Args:
        data: the tables of a bridge file.
        folder: where relative paths in it start.
        registry: gives the registry in the spawned process; a module-level function.
    """

    def __init__(
        self,
        data: Mapping[str, Any],
        *,
        folder: Path,
        registry: Callable[[], Registry] = Registry.installed,
    ) -> None:
        self._arguments = (dict(data), str(folder.resolve()), registry)
        self._process: BaseProcess | None = None
        self._pipe: Connection | None = None
        self.last_status: dict[str, str | float] = {}

    def __enter__(self) -> Self:
        context = multiprocessing.get_context("spawn")
        self._pipe, far = context.Pipe()
        self._process = context.Process(
            target=_main, args=(*self._arguments, far), name="clothrf-bridge", daemon=True
        )
        self._process.start()
        far.close()
        try:
            word = self._pipe.recv() if self._pipe.poll(START_TIMEOUT_S) else "no answer in time"
        except EOFError:
            word = "its process ended"
        if word != "ready":
            self._process.kill()
            raise BridgeUnreachable(f"expected the bridge to start, found: {word}")
        return self

    def __exit__(
        self,
        kind: type[BaseException] | None,
        error: BaseException | None,
        trace: TracebackType | None,
    ) -> None:
        assert self._process is not None
        assert self._pipe is not None
        try:
            self._pipe.send("stop")
            if self._pipe.poll(5.0):
                self.last_status = self._pipe.recv()
        except (OSError, EOFError):
            pass
        self._process.join(timeout=5.0)
        if self._process.is_alive():
            self._process.kill()
            self._process.join()
        self._pipe.close()

    @property
    def pid(self) -> int:
        """Process id of the running bridge."""
        assert self._process is not None
        assert self._process.pid is not None
        return self._process.pid


def _main(
    data: dict[str, Any], folder: str, registry: Callable[[], Registry], pipe: Connection
) -> None:
    signal.signal(signal.SIGINT, signal.SIG_IGN)
    try:
        known = registry()
        file = resolve_bridge(data, known, folder=Path(folder))
        # A closed pipe is readable too: the bridge does not outlive whoever started it.
        status = serve(file, known, WallClock(), pipe.poll, ready=lambda _text: pipe.send("ready"))
        pipe.send(status)
    except ClothrfError as error:
        pipe.send(str(error))
    except (OSError, EOFError):
        return
