"""The bridge process: clock, Zenoh and the robot's end around `bridge.Bridge`."""

from __future__ import annotations

import logging
import os
from collections.abc import Callable
from contextlib import ExitStack

from clothrf_core.clock import Clock
from clothrf_core.errors import ClothrfError
from clothrf_core.interfaces import BridgeEnd
from clothrf_core.punctual import punctual
from clothrf_core.registry import Registry
from clothrf_core.types import Float
from clothrf_zenoh import requests
from clothrf_zenoh.bridge import MOVING, Bridge
from clothrf_zenoh.checks import Instant
from clothrf_zenoh.compose import BridgeFile, bounds_of, build_arm, build_end
from clothrf_zenoh.messages import JointState, encode_diagnostics, encode_joint_state
from clothrf_zenoh.pace import Pace, settle_memory, wall_ns
from clothrf_zenoh.report import diagnostics_of, status_of
from clothrf_zenoh.requests import Reply
from clothrf_zenoh.session import keys_of, open_session
from clothrf_zenoh.wire import BridgeWire

logger = logging.getLogger(__name__)


class Server:
    """One running bridge.

    Args:
        bridge: the rules.
        wire: Zenoh, entered.
        end: the robot's end, entered.
        clock: time.
        rate_hz: ticks a second.
        state_rate_hz: joint states a second.
        health_rate_hz: diagnostics a second; a change is published at once as well.
    """

    def __init__(
        self,
        bridge: Bridge,
        wire: BridgeWire,
        end: BridgeEnd,
        clock: Clock,
        *,
        names: tuple[str, ...],
        rate_hz: float,
        state_rate_hz: float,
        health_rate_hz: float,
    ) -> None:
        self.bridge = bridge
        self.pace = Pace(clock, rate_hz)
        self._wire = wire
        self._end = end
        self._clock = clock
        self._names = names
        self._state_every = max(1, round(rate_hz / state_rate_hz))
        self._health_every = max(1, round(rate_hz / health_rate_hz))
        self._epoch = 0
        self._failed = False
        self._published = ("", "", True)

    def run(self, stop: Callable[[], bool]) -> None:
        """Tick until `stop`, then let the arms come to rest."""
        while not stop():
            self.pace.wait()
            self.tick()
        if self.bridge.state in MOVING:
            self.bridge.emergency_stop("the bridge's own end")
        while not self.bridge.at_rest:
            self.pace.wait()
            self.tick()
        self._publish_health(self._now())

    def tick(self) -> None:
        """Requests, commands, output, news: in this order, so that a stop is never late."""
        now = self._now()
        if self._wire.stop_pressed():
            self.bridge.emergency_stop("a message")
        self._wire.answer(self._handle)
        for attachment, payload in self._wire.commands():
            self.bridge.receive(attachment, payload, now)
        measured = self._measured()
        output = self.bridge.tick(now, measured)
        if output is not None:
            self._put(*output)
        ticks = self.pace.ticks
        if measured is not None and ticks % self._state_every == 0:
            state = JointState(now.wall_ns, "", self._names, *measured)
            self._wire.state.put(encode_joint_state(state), now.wall_ns)
        news = (str(self.bridge.state), self.bridge.why, self.bridge.at_rest)
        if news != self._published or ticks % self._health_every == 0:
            if news[:2] != self._published[:2]:
                logger.info("bridge: %s %s", *news[:2])
            self._published = news
            self._publish_health(now)

    def _measured(self) -> tuple[Float, Float] | None:
        """Where the arms are; an end that fails, or failed to take its last posture, has none."""
        failed, self._failed = self._failed, False
        try:
            return None if failed else self._end.measured()
        except ClothrfError as error:
            logger.error("bridge: the robot's end failed: %s", error)
            return None

    def _put(self, q: Float, qd: Float) -> None:
        try:
            self._end.put(q, qd)
        except ClothrfError as error:
            logger.error("bridge: the robot's end failed: %s", error)
            self._failed = True

    def _now(self) -> Instant:
        return Instant(self._clock.now_ns(), wall_ns())

    def status(self) -> dict[str, str | float]:
        """Everything worth knowing."""
        return status_of(self.bridge, self.pace, self._end.health(), epoch=self._epoch)

    def _publish_health(self, now: Instant) -> None:
        message = diagnostics_of(
            self.status(), stamp_ns=now.wall_ns, hardware=type(self._end).__name__
        )
        self._wire.health.put(encode_diagnostics(message), now.wall_ns)

    def _handle(self, verb: str, data: bytes) -> Reply:
        try:
            self._do(verb, data)
        except ClothrfError as error:
            logger.warning("bridge: %s refused: %s", verb, error)
            return self._reply(ok=False, reason=str(error))
        status = self.status() if verb == "status" else {}
        return self._reply(ok=True, status=status)

    def _reply(
        self, *, ok: bool, reason: str = "", status: dict[str, str | float] | None = None
    ) -> Reply:
        output = self.bridge.output
        return Reply(
            ok=ok,
            reason=reason,
            state=str(self.bridge.state),
            epoch=self._epoch,
            posture=[] if output is None else output[0].tolist(),
            status=dict(status or {}),
        )

    def _do(self, verb: str, data: bytes) -> None:
        if verb == "estop":
            # Whatever the text says: a stop is never refused for its spelling.
            try:
                who = str(requests.read(requests.EstopRequest, data).who)
            except ClothrfError:
                who = "somebody"
            self.bridge.emergency_stop(who)
        elif verb == "arm":
            wish: requests.ArmRequest = requests.read(requests.ArmRequest, data)
            grant = self.bridge.request_arms(
                gid=bytes.fromhex(wish.gid),
                sequence=wish.sequence,
                stamp_ns=wish.stamp_ns,
                lease_s=wish.lease_s,
                now=self._now(),
            )
            self._epoch = grant.epoch
        elif verb in ("renew", "release"):
            held: requests.GrantRequest = requests.read(requests.GrantRequest, data)
            gid = bytes.fromhex(held.gid)
            if verb == "renew":
                self.bridge.renew(gid=gid, epoch=held.epoch, now=self._now())
            else:
                self.bridge.release(gid=gid, epoch=held.epoch)
        elif verb == "clear":
            self.bridge.clear()


def serve(
    file: BridgeFile,
    registry: Registry,
    clock: Clock,
    stop: Callable[[], bool],
    *,
    ready: Callable[[str], None] = logger.info,
) -> dict[str, str | float]:
    """Run the bridge of `file` until `stop`; returns its last status.

    Raises:
        ConfigError: the config is wrong.
        UnsafeExposure: it would be open to strangers.
        BridgeUnreachable: its address is taken.
    """
    config = file.config
    arm = build_arm(file, registry)
    bounds = bounds_of(arm, config.limits, 1.0 / config.rate_hz)
    bridge = Bridge(
        arm,
        bounds,
        watchdog_s=config.limits.watchdog_s,
        max_gap_s=config.limits.max_gap_s,
        first_epoch=int(wall_ns() // 1_000_000_000) & 0xFFFFFFFF,
    )
    with ExitStack() as stack:
        scheduling = stack.enter_context(punctual(config.realtime_priority, cpu=config.cpu))
        session = stack.enter_context(open_session(config.zenoh, file.folder))
        end = stack.enter_context(build_end(file, registry))
        wire = stack.enter_context(BridgeWire(session, keys_of(config.zenoh), os.urandom(16)))
        server = Server(
            bridge,
            wire,
            end,
            clock,
            names=tuple(arm.joint_names),
            rate_hz=config.rate_hz,
            state_rate_hz=config.state_rate_hz,
            health_rate_hz=config.diagnostics_rate_hz,
        )
        settle_memory()
        where = ", ".join(config.zenoh.listen or config.zenoh.connect)
        ready(f"bridge: {config.rate_hz:g} Hz on {where}, {scheduling}")
        server.run(stop)
        return server.status()
