"""Two simulated controllers on UDP, each with its own phase, as the YuMi's two motion tasks have.

Whether an answer came in its own cycle is judged by the kernel's time stamp of its arrival, so that
this process may be late to read it without blaming the client.
"""

from __future__ import annotations

import contextlib
import select
import socket
import struct
import threading
import time
from collections.abc import Mapping, Sequence
from dataclasses import asdict
from types import TracebackType
from typing import Self

import numpy as np

from clothrf_core.types import Float
from clothrf_egm.controller import CYCLE_S, ControllerModel, SimulatedController
from clothrf_egm.messages import SensorMessage, decode_sensor
from clothrf_egm.wire import BrokenMessage

SO_TIMESTAMPNS = 35  # Linux; the socket module has no name for it
MOST_DELAYS = 100_000
Answer = tuple[SensorMessage, int]

PHASE_S = 0.0017  # the right arm asks this much after the left one


class EgmSimulator:
    """Both arms; a context manager whose thread sends a request every 4 ms and arm.

    Args:
        model: how the arms behave.
        posture: (14,) where they stand at first, rad, left arm first.
        host: where the bridge listens.
        ports: UDP ports of the left and the right arm there.
    """

    def __init__(
        self, model: ControllerModel, posture: Float, *, host: str, ports: Sequence[int]
    ) -> None:
        self.arms = [SimulatedController(model, part) for part in np.split(posture, 2)]
        self._peers = [(host, port) for port in ports]
        self._stop = threading.Event()
        self._lock = threading.Lock()
        self._delays: list[float] = []
        self._thread: threading.Thread | None = None

    def __enter__(self) -> Self:
        self._stop.clear()
        self._thread = threading.Thread(target=self.run, name="egm-sim", daemon=True)
        self._thread.start()
        return self

    def __exit__(
        self,
        kind: type[BaseException] | None,
        error: BaseException | None,
        trace: TracebackType | None,
    ) -> None:
        self._stop.set()
        if self._thread is not None:
            self._thread.join()

    @property
    def q(self) -> Float:
        """(14,) where the arms are, rad."""
        with self._lock:
            return np.concatenate([arm.q for arm in self.arms])

    def switch_motors(self, *, on: bool, arms: Sequence[int] = (0, 1)) -> None:
        """Motors of `arms`; switched on, their sessions begin anew."""
        with self._lock:
            for arm in (self.arms[i] for i in arms):
                arm.motors = on
                if on:
                    arm.restart()

    def unplug(self, arm: int) -> None:
        """From now on nothing comes from that arm's controller, and nothing reaches it."""
        with self._lock:
            self.arms[arm].unplugged = True

    def restart(self, arm: int) -> None:
        """Begin a new session of one arm, as a program that was started again."""
        with self._lock:
            self.arms[arm].restart()

    def counters(self) -> Mapping[str, float]:
        """`left_` and `right_` `ControllerCounters`, and how fast both are answered.

        `same_cycle_share`, and `delay_us`, `delay_p99_us`, `delay_max_us` from request to answer
        once there was one.
        """
        with self._lock:
            delays = 1e6 * np.array(self._delays)
            found = [asdict(arm.counters) for arm in self.arms]
        result = {
            f"{side}_{name}": float(value)
            for side, counters in zip(("left", "right"), found, strict=True)
            for name, value in counters.items()
        }
        # The newest request of each arm may still be answered.
        asked = sum(counters["requests"] - 1 for counters in found)
        result["same_cycle_share"] = (
            sum(counters["same_cycle"] for counters in found) / asked if asked > 0 else 0.0
        )
        if delays.size:
            names = ("delay_us", "delay_p99_us", "delay_max_us")
            result.update(zip(names, np.percentile(delays, [50, 99, 100]).tolist(), strict=True))
        return result

    def run(self, seconds: float = float("inf")) -> None:
        """Ask and follow until stopped, or for `seconds`."""
        sockets = [_open(host) for host, _ in self._peers]
        try:
            self._loop(sockets, time.monotonic() + seconds)
        finally:
            for own in sockets:
                own.close()

    def _loop(self, sockets: list[socket.socket], end: float) -> None:
        start = time.monotonic()
        due = [start, start + PHASE_S]
        sent_ns = [[0, 0], [0, 0]]  # of each arm: the request before the newest, the newest
        answers: list[Answer | None] = [None, None]
        while not self._stop.is_set():
            arm = 0 if due[0] <= due[1] else 1
            now = time.monotonic()
            if now > end:
                return
            if now < due[arm]:
                ready, _, _ = select.select(sockets, [], [], min(due[arm] - now, 0.1))
                for own in ready:
                    other = sockets.index(own)
                    answers[other] = _newest(own) or answers[other]
                continue
            answer = _newest(sockets[arm]) or answers[arm]
            answers[arm] = None
            delay = None if answer is None else _delay(answer[1], sent_ns[arm])
            with self._lock:
                request = self.arms[arm].cycle(
                    None if answer is None else answer[0],
                    in_time=delay is not None and delay <= CYCLE_S,
                )
                if request is not None and delay is not None and len(self._delays) < MOST_DELAYS:
                    self._delays.append(delay)
            if request is not None:
                sent_ns[arm] = [sent_ns[arm][1], time.time_ns()]
                _send(sockets[arm], request, self._peers[arm])
            # Late, it gives the client its 4 ms all the same.
            due[arm] = max(due[arm], now) + CYCLE_S


def _open(host: str) -> socket.socket:
    own = socket.socket(socket.AF_INET, socket.SOCK_DGRAM)
    own.bind(("127.0.0.1" if host.startswith("127.") else "", 0))
    own.setblocking(False)
    with contextlib.suppress(OSError):  # elsewhere than on Linux the reading time must do
        own.setsockopt(socket.SOL_SOCKET, SO_TIMESTAMPNS, 1)
    return own


def _delay(arrived_ns: int, sent_ns: list[int]) -> float:
    """Seconds from request to answer.

    Requests are answered in order: the newest answer is to the newest request, unless it is older
    than that; then it is to the one before, and late.
    """
    before, newest = sent_ns
    return 1e-9 * (arrived_ns - newest) if arrived_ns >= newest else 1e-9 * (arrived_ns - before)


def _newest(own: socket.socket) -> Answer | None:
    """The newest readable answer and when the kernel received it, wall clock in ns."""
    found: Answer | None = None
    while True:
        try:
            data, extra, _, _ = own.recvmsg(4096, 64)
        except BlockingIOError:
            return found
        except ConnectionError:
            continue  # nobody listens yet
        arrived = time.time_ns()
        for level, kind, value in extra:
            if level == socket.SOL_SOCKET and kind == SO_TIMESTAMPNS:
                seconds, rest = struct.unpack("@qq", value[:16])
                arrived = seconds * 1_000_000_000 + rest
        try:
            found = decode_sensor(data), arrived
        except BrokenMessage:
            continue


def _send(own: socket.socket, request: bytes, peer: tuple[str, int]) -> None:
    with contextlib.suppress(OSError):  # nobody listens; the next cycle tries again
        own.sendto(request, peer)
