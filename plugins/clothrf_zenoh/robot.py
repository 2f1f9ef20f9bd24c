"""The `Robot` of the control loop: hands targets to the stream process and says how it goes."""

from __future__ import annotations

import multiprocessing
import time
from collections.abc import Callable
from contextlib import ExitStack
from dataclasses import replace
from multiprocessing.process import BaseProcess
from pathlib import Path
from types import TracebackType
from typing import Self

import numpy as np
from typing_extensions import override

from clothrf_core.config import read_toml
from clothrf_core.errors import DataError
from clothrf_core.interfaces import Robot
from clothrf_core.registry import Registry
from clothrf_core.rig import Rig
from clothrf_core.types import GraspState, RobotCommand
from clothrf_zenoh.config import YumiZenohConfig
from clothrf_zenoh.faults import BridgeRefused, BridgeUnreachable
from clothrf_zenoh.mailbox import Mailbox, News, Wish
from clothrf_zenoh.process import BridgeProcess, egm_simulation, recording
from clothrf_zenoh.stream import StreamSetup, stream_main

START_TIMEOUT_S = 30.0


class StreamedYumi(Robot):
    """Two arms behind a bridge.

    Entering starts the stream's process and asks the bridge for the arms; leaving stops the arms,
    gives them back and ends the process. When the bridge has stopped the arms (see `status`), only
    `arm` starts them again.

    Args:
        config: the robot section.
        folder: where relative paths start.
        rig: the experiment's, for the arm model.
        registry: gives the registry in the spawned process; a module-level function.
    """

    def __init__(
        self,
        config: YumiZenohConfig,
        *,
        folder: Path,
        rig: Rig | None = None,
        registry: Callable[[], Registry] = Registry.installed,
    ) -> None:
        self._config = config
        self._folder = folder.resolve()
        self._registry = registry
        self._around = ExitStack()
        self._setup = StreamSetup(
            config.model_dump_json(),
            str(folder.resolve()),
            "" if rig is None else rig.model_dump_json(),
            registry,
        )
        self._process: BaseProcess | None = None
        self._wish = Wish()
        self._wishes: Mailbox
        self._news: Mailbox

    @override
    def __enter__(self) -> Self:
        context = multiprocessing.get_context("spawn")
        try:
            self._begin_around()
        except BaseException:
            self._around.close()
            raise
        self._wishes = Mailbox(context, Wish.LAYOUT.size)
        self._news = Mailbox(context, News.LAYOUT.size)
        self._wish = Wish()
        self._process = context.Process(
            target=stream_main,
            args=(self._setup, self._wishes, self._news),
            name="clothrf-stream",
            daemon=True,
        )
        self._process.start()
        try:
            self._wait(lambda news: news.phase == "ready" and news.measured_ns > 0, "a bridge")
            self.arm()
        except BaseException:
            self._leave()
            raise
        return self

    @override
    def __exit__(
        self,
        kind: type[BaseException] | None,
        error: BaseException | None,
        trace: TracebackType | None,
    ) -> None:
        self._leave()

    def arm(self) -> None:
        """Ask the bridge for the arms: the only way into motion, also after every stop.

        Raises:
            BridgeRefused: not now; says why.
            BridgeUnreachable: no bridge answers.
        """
        number = self._wish.arm_requests + 1
        self._tell(replace(self._wish, arm_requests=number, hold=True))
        news = self._wait(lambda news: news.arm_answers >= number, "an answer to the arm request")
        if news.phase != "streaming":
            raise BridgeRefused(news.why or "expected the arms, found them taken back at once")

    @override
    def state(self) -> GraspState:
        news = self.news()
        return GraspState(news.grasp, news.measured_ns)

    @override
    def send(self, command: RobotCommand) -> RobotCommand:
        news = self.news()
        held = command.held
        if not held and not np.isfinite(command.targets).all():
            held = "targets are not finite"
        if not held and news.phase != "streaming":
            held = f"bridge {news.bridge}: {news.why}"
        self._tell(
            replace(
                self._wish,
                number=self._wish.number + 1,
                sent_ns=time.monotonic_ns(),
                valid_for_s=command.valid_for_s,
                hold=bool(held),
                targets=np.nan_to_num(command.targets),
            )
        )
        return replace(command, held=held) if held != command.held else command

    def news(self) -> News:
        """What the stream said last.

        Raises:
            BridgeUnreachable: the stream's process has ended.
        """
        data = self._news.get() if self._process is not None else None
        news = News() if data is None else News.decode(data)
        if news.phase == "failed":
            raise BridgeUnreachable(news.why)
        if self._process is None or not self._process.is_alive():
            raise BridgeUnreachable("expected a running stream, found its process ended")
        return news

    def status(self) -> dict[str, str | float]:
        """For a live line: what the bridge and the stream do, and why they stand still."""
        news = self.news()
        return {
            "stream": news.phase,
            "bridge": news.bridge,
            "why": news.why,
            "sent": news.sent,
            "refused": news.refused,
            "rate_hz": news.rate_hz,
            "lateness_p99_us": news.lateness_p99_us,
            "age_ms": 1e-6 * (time.monotonic_ns() - news.measured_ns),
            "least_clearance_m": news.least_clearance,
        }

    def _begin_around(self) -> None:
        """What a rehearsal on one machine needs besides the stream."""
        config = self._config
        if config.bridge is not None:
            path = self._folder / config.bridge
            tables = read_toml(path)
            bridge = BridgeProcess(tables, folder=path.parent, registry=self._registry)
            self._around.enter_context(bridge)
            end = tables.get("end", {})
            local = end.get("plugin") == "egm" and end.get("host", "127.0.0.1") == "127.0.0.1"
            if local and config.simulate_controller:
                ports = (int(end.get("left_port", 6511)), int(end.get("right_port", 6512)))
                self._around.enter_context(egm_simulation(*ports))
        if config.record is not None:
            path = self._folder / config.record
            if path.exists():
                raise DataError(f"robot.record: expected a new file name, found a file at {path}")
            self._around.enter_context(recording(config.zenoh, self._folder, path))

    def _tell(self, wish: Wish) -> None:
        self._wish = wish
        self._wishes.put(wish.encode())

    def _wait(self, reached: Callable[[News], bool], what: str) -> News:
        deadline = time.monotonic() + START_TIMEOUT_S
        while True:
            news = self.news()
            if reached(news):
                return news
            if time.monotonic() > deadline:
                raise BridgeUnreachable(f"expected {what} within {START_TIMEOUT_S:g} s, found none")
            time.sleep(0.005)

    def _leave(self) -> None:
        process, self._process = self._process, None
        if process is not None:
            self._tell(replace(self._wish, leave=True))
            process.join(timeout=3.0)
            if process.is_alive():
                # The bridge's watchdog stops the arms.
                process.kill()
                process.join(timeout=1.0)
        self._around.close()
