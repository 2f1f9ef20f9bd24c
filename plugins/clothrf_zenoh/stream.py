"""The 250 Hz process: nothing that the controller computes can delay it.

It reads the newest wish from shared memory, turns it into a joint motion and streams that to the
bridge; it keeps the lease only while the controller shows signs of life, and stops the arms when
the controller asks to leave, is killed or falls silent.
"""

from __future__ import annotations

import os
import signal
from collections.abc import Callable
from contextlib import ExitStack
from dataclasses import dataclass
from pathlib import Path

import numpy as np

from clothrf_core.clock import Clock, WallClock
from clothrf_core.errors import ClothrfError, RefusedTarget
from clothrf_core.interfaces import ArmModel
from clothrf_core.provider import BuildContext
from clothrf_core.punctual import punctual
from clothrf_core.registry import Registry
from clothrf_core.rig import Rig
from clothrf_zenoh.client import BridgeClient
from clothrf_zenoh.compose import choose
from clothrf_zenoh.config import YumiZenohConfig
from clothrf_zenoh.follower import Follower
from clothrf_zenoh.mailbox import Mailbox, News, Wish
from clothrf_zenoh.pace import Pace, settle_memory
from clothrf_zenoh.session import keys_of, open_session

RENEWALS_PER_LEASE = 3


@dataclass(frozen=True, slots=True)
class StreamSetup:
    """All that the process needs; plain data, so that it can be spawned.

    Attributes:
        config: the robot section as JSON.
        folder: where relative paths start.
        rig: the experiment's rig as JSON; "" where there is none.
        registry: gives the registry that the arm model is looked up in.
    """

    config: str
    folder: str
    rig: str
    registry: Callable[[], Registry]


class Stream:
    """The loop's body, one call a tick.

    Args:
        arm: kinematics.
        client: entered and in contact with the bridge.
        config: the robot section.
        clock: time.
    """

    def __init__(
        self, arm: ArmModel, client: BridgeClient, config: YumiZenohConfig, clock: Clock
    ) -> None:
        self._arm = arm
        self._client = client
        self._config = config
        self._clock = clock
        self._follower: Follower | None = None
        self._answered = 0
        self._seen = 0
        self._sent = 0
        self._refused = 0
        self._armed_at = 0
        self._renewed_ns = 0
        self._measured_ns = 0
        self._grasp = np.zeros((2, 3))
        self._why = ""
        self._late_us = 0.0
        self.done = False

    def tick(self, wish: Wish, *, orphaned: bool) -> None:
        """Read the bridge's news, follow the wish, send one joint command."""
        now = self._clock.now_ns()
        client = self._client
        if client.poll() and client.joints is not None:
            self._grasp = self._arm.grasp_points(client.joints.positions)
            self._measured_ns = now
        leave = wish.leave or orphaned
        if wish.arm_requests > self._answered and not leave:
            self._arm_now(wish, now)
        if not client.held:
            if self._follower is not None:
                self._why = client.status.get("reason", "") or "the bridge took the arms back"
            self._follower = None
        if self._follower is None:
            self.done = leave
            return
        self._follow(self._follower, wish, now, leave=leave)
        # Before its first command a controller may take its time: the arms stand still.
        waiting = wish.number == self._armed_at
        alive = waiting or now - wish.sent_ns < 1e9 * self._config.deadman_s
        lease_ns = int(1e9 * self._config.lease_s)
        if alive and now - self._renewed_ns > lease_ns // RENEWALS_PER_LEASE:
            self._renewed_ns = now
            client.renew()
        if leave and self._follower.at_rest:
            try:
                client.release()
            except ClothrfError as error:
                self._why = str(error)
            self.done = True

    def _arm_now(self, wish: Wish, now: int) -> None:
        self._follower = None
        try:
            q = self._client.arm(self._config.lease_s)
            self._follower = Follower(
                self._arm,
                dt=1.0 / self._config.rate_hz,
                q=q,
                tcp_speed=self._config.tcp_speed,
                max_step=self._config.max_step,
            )
            self._renewed_ns = now
            self._seen = self._armed_at = wish.number
            self._why = ""
        except ClothrfError as error:
            self._why = str(error)
        self._answered = wish.arm_requests

    def _follow(self, follower: Follower, wish: Wish, now: int, *, leave: bool) -> None:
        stale = now - wish.sent_ns > 1e9 * wish.valid_for_s
        if leave or stale or wish.hold:
            follower.halt()
        elif wish.number != self._seen:
            self._seen = wish.number
            try:
                follower.aim(wish.targets)
                self._client.send_targets(wish.targets)
                self._why = ""
            except RefusedTarget as error:
                self._refused += 1
                self._why = str(error)
        try:
            q, qd = follower.tick()
        except RefusedTarget as error:
            self._refused += 1
            self._why = str(error)
            q, qd = follower.tick()
        self._client.send(q, qd)
        self._sent += 1

    def news(self, phase: str, pace: Pace) -> News:
        """What the controller is told."""
        if pace.ticks % 125 == 0:
            self._late_us = pace.lateness.spread().p99
        status = self._client.status
        return News(
            phase=phase,
            bridge=status.get("state", ""),
            why=self._why or status.get("reason", ""),
            measured_ns=self._measured_ns,
            grasp=self._grasp,
            arm_answers=self._answered,
            sent=self._sent,
            refused=self._refused,
            rate_hz=self._config.rate_hz if self._follower is not None else 0.0,
            lateness_p99_us=self._late_us,
            least_clearance=float(status.get("least_clearance_m", "0")),
        )


def stream_main(setup: StreamSetup, wishes: Mailbox, news: Mailbox) -> None:
    """Body of the spawned process."""
    # Ctrl-C reaches every process of the terminal; the controller decides what it means.
    signal.signal(signal.SIGINT, signal.SIG_IGN)
    parent = os.getppid()
    try:
        _stream(setup, wishes, news, parent)
    except ClothrfError as error:
        news.put(News(phase="failed", why=str(error)).encode())


def _stream(setup: StreamSetup, wishes: Mailbox, news: Mailbox, parent: int) -> None:
    config = YumiZenohConfig.model_validate_json(setup.config)
    folder = Path(setup.folder)
    registry = setup.registry()
    name, options = choose("arm", "robot.arm", config.arm, registry)
    rig = Rig.model_validate_json(setup.rig) if setup.rig else None
    context = BuildContext(rig=rig, folder=folder, registry=registry)
    arm: ArmModel = registry.build("arm", name, options, context)
    clock = WallClock()
    with ExitStack() as stack:
        stack.enter_context(punctual(config.realtime_priority))
        session = stack.enter_context(open_session(config.zenoh, folder))
        client = stack.enter_context(
            BridgeClient(
                session,
                keys_of(config.zenoh),
                os.urandom(16),
                tuple(arm.joint_names),
                period_s=1.0 / config.rate_hz,
            )
        )
        client.wait_for_bridge(config.state_timeout_s)
        stream = Stream(arm, client, config, clock)
        settle_memory()
        pace = Pace(clock, config.rate_hz)
        while not stream.done:
            pace.wait()
            data = wishes.get()
            wish = Wish() if data is None else Wish.decode(data)
            stream.tick(wish, orphaned=os.getppid() != parent)
            news.put(stream.news("streaming" if client.held else "ready", pace).encode())
        news.put(stream.news("stopped", pace).encode())
