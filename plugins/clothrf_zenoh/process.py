"""Bridge, simulated controller and recorder as processes, for who brings up all of it at once."""

from __future__ import annotations

import contextlib
import json
import logging
import multiprocessing
import signal
import subprocess
import sys
from collections.abc import Callable, Iterator, Mapping
from multiprocessing.connection import Connection
from multiprocessing.process import BaseProcess
from pathlib import Path
from types import TracebackType
from typing import Any, Self

from clothrf_core.clock import WallClock
from clothrf_core.errors import ClothrfError
from clothrf_core.registry import Registry
from clothrf_zenoh.compose import resolve_bridge
from clothrf_zenoh.config import ZenohSection
from clothrf_zenoh.faults import BridgeUnreachable
from clothrf_zenoh.serve import serve

START_TIMEOUT_S = 30.0

_CLOTHRF = "from clothrf_core.cli import main; main()"


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


@contextlib.contextmanager
def egm_simulation(left_port: int, right_port: int) -> Iterator[dict[str, Any]]:
    """`clothrf egm-sim` while the block runs; afterwards its counters are in what was yielded."""
    ports = ["--left-port", str(left_port), "--right-port", str(right_port)]
    process = subprocess.Popen(
        [sys.executable, "-c", _CLOTHRF, "egm-sim", *ports, "--json"],
        stdout=subprocess.PIPE,
        text=True,
        start_new_session=True,  # Ctrl-C is for the controller, which stops the arms first
    )
    counters: dict[str, Any] = {}
    try:
        yield counters
    finally:
        process.send_signal(signal.SIGINT)
        try:
            counters.update(json.loads(process.communicate(timeout=10.0)[0]))
        except (subprocess.TimeoutExpired, ValueError):
            process.kill()
            process.wait()


@contextlib.contextmanager
def recording(section: ZenohSection, folder: Path, path: Path) -> Iterator[None]:
    """A recorder in a process of its own while the block runs."""
    context = multiprocessing.get_context("spawn")
    near, far = context.Pipe()
    process = context.Process(
        target=_record, args=(section.model_dump_json(), str(folder), str(path), far), daemon=True
    )
    process.start()
    far.close()
    try:
        yield
    finally:
        with contextlib.suppress(OSError):
            near.send("stop")
        process.join(timeout=10.0)
        near.close()


def _record(section: str, folder: str, path: str, pipe: Connection) -> None:
    from clothrf_zenoh.record import record

    signal.signal(signal.SIGINT, signal.SIG_IGN)
    try:
        record(
            ZenohSection.model_validate_json(section),
            Path(folder),
            Path(path),
            WallClock(),
            pipe.poll,
        )
    except ClothrfError as error:
        logging.getLogger(__name__).error("record: %s", error)
