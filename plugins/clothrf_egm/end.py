"""The bridge end `egm`: answers both arms' controllers the moment they ask.

One thread waits on both sockets. It computes for some 50 us a request and otherwise sleeps in the
kernel, without the interpreter's lock; the bridge's own thread must not hold that lock for long
either, which is why the bridge is a process of its own.
"""

from __future__ import annotations

import selectors
import socket
import threading
import time
from collections.abc import Callable, Mapping
from dataclasses import asdict
from types import TracebackType
from typing import Self

import numpy as np
from typing_extensions import override

from clothrf_core.errors import ClothrfError
from clothrf_core.interfaces import BridgeEnd
from clothrf_core.types import Float
from clothrf_egm.config import EgmConfig
from clothrf_egm.session import Session, SessionRules

ARM = 7
LARGEST_DATAGRAM = 65536
STILL = 0.02  # rad/s; after a restart nothing is measured until the arms stand


class EgmEnd(BridgeEnd):
    """Joint vectors are (14,) radians: left arm, then right arm, each along its chain.

    Args:
        config: see `EgmConfig`.
        clock: monotonic seconds.
    """

    def __init__(self, config: EgmConfig, *, clock: Callable[[], float] = time.monotonic) -> None:
        self._config, self._clock = config, clock
        rules = SessionRules(
            timeout=config.timeout,
            silence=config.silence,
            start_tolerance=config.start_tolerance,
            speed_reference=config.speed_reference,
        )
        self._sessions = (Session(rules), Session(rules))
        self._settling = True
        self._refused = 0
        self._sockets: list[socket.socket] = []
        self._wake: tuple[socket.socket, socket.socket] | None = None
        self._thread: threading.Thread | None = None

    @override
    def __enter__(self) -> Self:
        try:
            for port in (self._config.left_port, self._config.right_port):
                self._sockets.append(self._open(port))
        except ClothrfError:
            self._close()
            raise
        self._wake = socket.socketpair()
        self._thread = threading.Thread(target=self._serve, name="egm", daemon=True)
        self._thread.start()
        return self

    def _open(self, port: int) -> socket.socket:
        host = self._config.host
        try:
            listener = socket.socket(socket.AF_INET, socket.SOCK_DGRAM)
        except OSError as error:
            raise ClothrfError(f"bridge_end.host: no UDP socket to be had: {error}") from error
        try:
            listener.bind((host, port))
        except OSError as error:
            listener.close()
            raise ClothrfError(
                f"bridge_end: expected a free UDP port {port} of an address of this machine, found "
                f"{host}: {error}; is another bridge running?"
            ) from error
        listener.setblocking(False)
        return listener

    @property
    def ports(self) -> tuple[int, int]:
        """UDP ports of the left and the right arm while entered."""
        left, right = self._sockets
        return int(left.getsockname()[1]), int(right.getsockname()[1])

    @override
    def __exit__(
        self,
        kind: type[BaseException] | None,
        error: BaseException | None,
        trace: TracebackType | None,
    ) -> None:
        if self._wake is not None:
            self._wake[0].send(b"x")
        if self._thread is not None:
            self._thread.join()
            self._thread = None
        self._close()

    def _close(self) -> None:
        for thing in (*self._sockets, *(self._wake or ())):
            thing.close()
        self._sockets, self._wake = [], None

    def _serve(self) -> None:
        assert self._wake is not None
        with selectors.DefaultSelector() as selector:
            selector.register(self._wake[1], selectors.EVENT_READ, None)
            for listener, session in zip(self._sockets, self._sessions, strict=True):
                selector.register(listener, selectors.EVENT_READ, session)
            while True:
                for ready, _ in selector.select():
                    if ready.data is None:
                        return
                    self._answer_all(ready.fileobj, ready.data)  # type: ignore[arg-type]

    def _answer_all(self, listener: socket.socket, session: Session) -> None:
        while True:
            try:
                data, source = listener.recvfrom(LARGEST_DATAGRAM)
            except BlockingIOError:
                return
            except OSError:
                continue  # an ICMP error of an earlier answer: the controller has gone
            only = self._config.controller
            if only is not None and source[0] != only:
                session.counters.foreign += 1
                continue
            reply = session.answer(data, source, self._clock())
            if reply is not None:
                try:
                    listener.sendto(reply, source)
                except OSError:
                    session.counters.lost += 1

    @override
    def measured(self) -> tuple[Float, Float] | None:
        now = self._clock()
        # Both are asked, so that the restart of each is noticed.
        left, right = (session.measured(now) for session in self._sessions)
        if left is None or right is None:
            self._settling = True
            return None
        q, qd = (np.concatenate(pair) for pair in zip(left, right, strict=True))
        if self._settling and np.abs(qd).max() > STILL:
            return None
        self._settling = False
        return q, qd

    @override
    def put(self, q: Float, qd: Float) -> None:
        now = self._clock()
        posture, speed = np.array(q, dtype=np.float64), np.array(qd, dtype=np.float64)
        if posture.shape != (2 * ARM,) or speed.shape != posture.shape:
            raise ClothrfError(
                f"egm: expected {2 * ARM} angles and speeds, found shapes {posture.shape} and "
                f"{speed.shape}"
            )
        if not (np.isfinite(posture).all() and np.isfinite(speed).all()):
            raise ClothrfError("egm: expected finite angles and speeds; the last posture is held")
        arms = (slice(0, ARM), slice(ARM, 2 * ARM))
        pairs = list(zip(arms, self._sessions, strict=True))
        if self._settling:
            # `measured` has said that an arm is missing: what comes now stops the other one.
            pairs = [(arm, session) for arm, session in pairs if session.following]
        # Both or none: they hold the same cloth.
        if not pairs or not all(session.accepts(posture[arm]) for arm, session in pairs):
            self._refused += 1
            return
        for arm, session in pairs:
            session.put(posture[arm], speed[arm], now)

    @override
    def health(self) -> Mapping[str, float]:
        """`left_` and `right_`: see `Counters`; `age` in seconds, `ready` 0 or 1.

        `refused` counts postures put before the arms could be moved.
        """
        now = self._clock()
        health: dict[str, float] = {"refused": float(self._refused)}
        for side, session in zip(("left", "right"), self._sessions, strict=True):
            for name, value in asdict(session.counters).items():
                health[f"{side}_{name}"] = float(value)
            health[f"{side}_age"] = session.age(now)
            health[f"{side}_ready"] = float(session.ready)
        return health
