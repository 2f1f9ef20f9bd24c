"""Figures of the stream and the bridge, for `clothrf bench robot`: real processes, real sockets."""

from __future__ import annotations

import contextlib
import multiprocessing
import os
import signal
import socket
import time
from collections.abc import Iterator, Mapping
from multiprocessing.process import BaseProcess
from pathlib import Path
from typing import Any

import numpy as np

from clothrf_core.clock import WallClock
from clothrf_core.errors import ClothrfError
from clothrf_core.interfaces import ArmModel
from clothrf_core.provider import Figure
from clothrf_core.punctual import punctual
from clothrf_core.registry import Registry
from clothrf_core.types import Float, RobotCommand
from clothrf_zenoh.attachment import Attachment
from clothrf_zenoh.bridge import Bridge
from clothrf_zenoh.checks import Instant
from clothrf_zenoh.client import BridgeClient
from clothrf_zenoh.compose import bounds_of, choose
from clothrf_zenoh.config import LimitsSection, YumiZenohConfig, ZenohSection
from clothrf_zenoh.faults import BridgeRefused
from clothrf_zenoh.messages import JointTrajectoryCodec, epoch_frame
from clothrf_zenoh.pace import Pace, wall_ns
from clothrf_zenoh.process import BridgeProcess, egm_simulation
from clothrf_zenoh.robot import StreamedYumi
from clothrf_zenoh.session import keys_of, open_session

DT = 0.004
DT_NS = 4_000_000
GID = bytes(range(16))
ARM: Mapping[str, Any] = {"plugin": "yumi", "profile": "normal"}
MOST_DISTURBED = 12
# Axes 1 and 6 of both arms, in chain order: a shoulder and a wrist at their full profile speed.
SWUNG = (0, 6, 7, 13)
WIDE: Mapping[str, Any] = {
    "tcp_speed": 1.4,
    "tcp_speed_hard": 1.5,
    "box_low": [-1.0, -1.0, -1.0],
    "box_high": [2.0, 2.0, 2.0],
    "following": 1.0,
}


def _arm(registry: Registry) -> ArmModel:
    name, options = choose("arm", "arm", ARM, registry)
    arm: ArmModel = registry.build("arm", name, options)
    return arm


def tick(*, quick: bool) -> list[Figure]:
    """`bridge_tick_us`: one command taken in, all checks, Ruckig, output; arms in slow motion."""
    arm = _arm(Registry.installed())
    bounds = bounds_of(arm, LimitsSection(**WIDE), DT)
    bridge, codec = Bridge(arm, bounds), JointTrajectoryCodec(tuple(arm.joint_names))
    ready = arm.ready
    output: tuple[Float, Float] | None = (ready, np.zeros(len(ready)))
    now = Instant(10**9, 10**18)
    bridge.tick(now, output)
    grant = bridge.request_arms(gid=GID, sequence=0, stamp_ns=now.wall_ns, lease_s=1e6, now=now)
    limiter = arm.limiter(DT, q=ready)
    phase = np.arange(len(ready))
    count = 1000 if quick else 10_000
    cpu, wall = np.zeros(count), np.zeros(count)
    for i in range(count):
        at = Instant(now.mono_ns + (i + 1) * DT_NS, now.wall_ns + (i + 1) * DT_NS)
        # 30 Hz targets on a slow wave, smoothed as the sender smooths them.
        wave = 2.0 * np.pi * 0.3 * DT * (i - i % 8)
        goal = ready + 0.1 * (np.sin(wave + phase) - np.sin(phase))
        q, qd, _ = limiter.tick(goal)
        command = (
            Attachment(i + 1, at.wall_ns, GID).encode(),
            codec.encode(at.wall_ns, epoch_frame(grant.epoch), q, qd, DT_NS),
        )
        begun, worked = time.perf_counter_ns(), time.thread_time_ns()
        bridge.receive(*command, at)
        output = bridge.tick(at, output)
        cpu[i], wall[i] = time.thread_time_ns() - worked, time.perf_counter_ns() - begun
    assert bridge.tally.accepted == count, bridge.why
    p10, p50, p99 = np.percentile(cpu / 1e3, [10, 50, 99])
    detail = {
        "p10": float(p10),
        "p99": float(p99),
        "max": float(cpu.max() / 1e3),
        "wall_p50": float(np.percentile(wall, 50) / 1e3),
        "wall_p99": float(np.percentile(wall, 99) / 1e3),
        "clock": "thread CPU time; wall_* by the wall clock",
    }
    return [Figure("bridge_tick_us", float(p50), "us", detail)]


def stream(*, quick: bool) -> list[Figure]:
    """`stream_lost`: 250 Hz for 2 minutes (quick: 4 s) into two simulated EGM controllers.

    Sender, bridge and controllers are processes. Lost and reordered messages are counted by the
    bridge from the sequence numbers. The watchdog is slack here, so that a busy machine delays
    messages without ending the measurement; `interruptions` counts how often the arms had to be
    asked for again all the same.
    """
    seconds = 4.0 if quick else 120.0
    port = _free_port()
    config = YumiZenohConfig(
        arm=dict(ARM),
        zenoh=ZenohSection(connect=[f"tcp/127.0.0.1:{port}"], lease_s=5.0),
        lease_s=2.0,
        deadman_s=2.0,
        state_timeout_s=20.0,
    )
    slack = {"watchdog_s": 2.0, "max_age_s": 2.0, "max_gap_s": 2.0}
    here = Path()
    tables = _bridge(port, {**WIDE, **slack})
    tables["state_rate_hz"] = 50.0
    tables["end"], controllers = _controllers()
    far = BridgeProcess(tables, folder=here)
    with far, controllers as counters, StreamedYumi(config, folder=here) as robot:
        rest = robot.state().positions
        begun = time.monotonic()
        number = interruptions = 0
        while (passed := time.monotonic() - begun) < seconds:
            if robot.status()["stream"] != "streaming":
                interruptions += 1
                _arm_again(robot)
            angle = 2.0 * np.pi * 0.2 * passed
            circle = 0.03 * np.array([0.0, np.sin(angle), np.cos(angle) - 1.0])
            robot.send(RobotCommand(number, time.monotonic_ns(), 1.0, rest + circle))
            number += 1
            time.sleep(1 / 30)
        status = robot.status()
    counted = far.last_status
    lost = float(counted["lost"]) + float(counted.get("refused.old_sequence", 0))
    detail = {
        "sent": status["sent"],
        "seconds": seconds,
        "interruptions": interruptions,
        "sender_lateness_p99_us": status["lateness_p99_us"],
        **{k: v for k, v in counted.items() if k not in ("reason", "last_refusal", "state")},
        **{f"controllers_{name}": value for name, value in counters.items()},
    }
    return [Figure("stream_lost", lost, "messages", detail)]


def _arm_again(robot: StreamedYumi, patience_s: float = 10.0) -> None:
    """Ask until the arms are granted: a stop may still be under way."""
    deadline = time.monotonic() + patience_s
    while True:
        try:
            robot.arm()
            return
        except BridgeRefused:
            if time.monotonic() > deadline:
                raise
            time.sleep(0.1)


def _controllers() -> tuple[dict[str, Any], contextlib.AbstractContextManager[dict[str, Any]]]:
    """The bridge's end and, where `clothrf egm-sim` is installed, the controllers behind it."""
    commands = {command.name for command in Registry.installed().commands}
    if "egm-sim" not in commands:
        return {"plugin": "sim"}, contextlib.nullcontext({})
    left, right = _free_port(socket.SOCK_DGRAM), _free_port(socket.SOCK_DGRAM)
    end = {"plugin": "egm", "left_port": left, "right_port": right}
    return end, egm_simulation(left, right)


def watchdog(*, quick: bool) -> list[Figure]:
    """`watchdog_detect_ms_max`, `watchdog_stop_ms_max`: sender killed, stopped, cut off.

    The joints run at the full speed of the normal profile, half of the robot's. Detection counts
    from the cut to the bridge's own stamp of HOLD, the stop from there to the stamp of standstill.
    On a busy machine the bridge may stop a swing before it is cut; that one is `disturbed` and made
    again.
    """
    detections: dict[str, list[float]] = {"killed": [], "stopped": [], "cut": []}
    stops: dict[str, list[float]] = {"killed": [], "stopped": [], "cut": []}
    disturbed: list[str] = []
    with BridgeProcess(_bridge(port := _free_port(), WIDE), folder=Path()):
        for way in [*detections] * (1 if quick else 4):
            while True:
                try:
                    detected, stopped = _cut(port, way)
                    break
                except _Disturbed as error:
                    disturbed.append(str(error))
                    if len(disturbed) > MOST_DISTURBED:
                        raise
            detections[way].append(detected)
            stops[way].append(stopped)
    times = {"disturbed": len(disturbed)}
    return [
        Figure(name, max(map(max, found.values())), "ms", {**found, **times})
        for name, found in (
            ("watchdog_detect_ms_max", detections),
            ("watchdog_stop_ms_max", stops),
        )
    ]


class _Disturbed(ClothrfError):
    """A swing that ended before it was cut."""


def _cut(port: int, way: str) -> tuple[float, float]:
    """One cut at full speed: (ms from cut to detection, ms from detection to standstill)."""
    registry = Registry.installed()
    arm = _arm(registry)
    # What the lagging end measures just before it is told anew is 0.90 of the speed.
    fast = 0.88 * arm.limits.velocity[SWUNG[0]]
    context = multiprocessing.get_context("spawn")
    with contextlib.ExitStack() as stack:
        relay = stack.enter_context(_relay(context, port)) if way == "cut" else None
        sender = context.Process(
            target=_swing, args=(relay[0] if relay else port, 120.0), daemon=True
        )
        eye = stack.enter_context(_client(port, tuple(arm.joint_names), os.urandom(16)))
        eye.wait_for_bridge(10.0)
        sender.start()
        stack.callback(sender.join)
        stack.callback(sender.kill)
        deadline = time.monotonic() + 30.0
        running = False
        while True:
            eye.poll()
            running = running or eye.status.get("state") == "RUNNING"
            if running and eye.joints is not None:
                if abs(eye.joints.velocities[SWUNG[0]]) >= fast:
                    break
                if eye.status.get("state") == "HOLD":
                    raise _Disturbed(f"expected a swing, found HOLD: {eye.status['reason']}")
            if time.monotonic() > deadline:
                raise _Disturbed(f"expected full speed, found none: {dict(eye.status)}")
            time.sleep(0.0005)
        assert sender.pid is not None
        victim = relay[1].pid if relay else sender.pid
        assert victim is not None
        os.kill(victim, signal.SIGKILL if way == "killed" else signal.SIGSTOP)
        cut_ns = wall_ns()
        held_ns = _stamp_of(eye, lambda status: status["state"] == "HOLD")
        rest_ns = _stamp_of(
            eye, lambda status: status["state"] == "HOLD" and status["at_rest"] == "True"
        )
    return 1e-6 * (held_ns - cut_ns), 1e-6 * (rest_ns - held_ns)


def _stamp_of(eye: BridgeClient, reached: Any, timeout_s: float = 5.0) -> int:
    """The bridge's stamp of the first news for which `reached`."""
    deadline = time.monotonic() + timeout_s
    while time.monotonic() < deadline:
        for stamp_ns, status in eye.hear():
            if reached(status):
                return stamp_ns
        time.sleep(0.0005)
    raise _Disturbed(f"expected the bridge's news of the cut, found {dict(eye.status)}")


def _swing(port: int, seconds: float) -> None:
    """Body of the sender that is cut: shoulders and wrists to and fro at full speed."""
    arm = _arm(Registry.installed())
    clock = WallClock()
    with punctual(), _client(port, tuple(arm.joint_names), os.urandom(16)) as client:
        client.wait_for_bridge(10.0)
        deadline = time.monotonic() + 5.0
        while client.status.get("at_rest") != "True" and time.monotonic() < deadline:
            client.poll()
            time.sleep(0.01)
        q = client.arm(2.0)
        limiter = arm.limiter(DT, q=q)
        swing = np.zeros(len(q))
        swing[list(SWUNG)] = 0.5
        pace, goal, sign = Pace(clock, 1.0 / DT), q, 1.0
        begun = renewed = clock.now_ns()
        while client.held and clock.now_ns() - begun < 1e9 * seconds:
            pace.wait()
            client.poll()
            at, speed, _ = limiter.tick(goal)
            if np.abs(at - goal).max() < 0.02:
                sign = -sign
                goal = arm.ready + sign * swing
            client.send(at, speed)
            if clock.now_ns() - renewed > 300_000_000:
                renewed = clock.now_ns()
                client.renew()


@contextlib.contextmanager
def _client(port: int, names: tuple[str, ...], gid: bytes) -> Iterator[BridgeClient]:
    section = ZenohSection(connect=[f"tcp/127.0.0.1:{port}"], lease_s=5.0)
    with (
        open_session(section, Path()) as session,
        BridgeClient(session, keys_of(section), gid, names, period_s=DT) as client,
    ):
        yield client


@contextlib.contextmanager
def _relay(context: Any, port: int) -> Iterator[tuple[int, BaseProcess]]:
    """A TCP cable as a process of its own: stopping it is cutting the cable."""
    mine = _free_port()
    process = context.Process(target=_carry, args=(mine, port), daemon=True)
    process.start()
    try:
        deadline = time.monotonic() + 10.0
        while time.monotonic() < deadline:
            with contextlib.suppress(OSError), socket.create_connection(("127.0.0.1", mine)):
                break
            time.sleep(0.02)
        yield mine, process
    finally:
        process.kill()
        process.join()


def _carry(mine: int, port: int) -> None:
    """Copy bytes both ways between whoever connects to `mine` and `port`."""
    import selectors

    selector = selectors.DefaultSelector()
    listener = socket.create_server(("127.0.0.1", mine))
    selector.register(listener, selectors.EVENT_READ, None)
    while True:
        for key, _ in selector.select():
            if key.data is None:
                near, _ = listener.accept()
                far = socket.create_connection(("127.0.0.1", port))
                for one, other in ((near, far), (far, near)):
                    one.setsockopt(socket.IPPROTO_TCP, socket.TCP_NODELAY, 1)
                    selector.register(one, selectors.EVENT_READ, other)
                continue
            source: Any = key.fileobj
            try:
                data = source.recv(65536)
                if data:
                    key.data.sendall(data)
            except OSError:
                data = b""
            if not data:
                for one in (source, key.data):
                    with contextlib.suppress(KeyError, ValueError):
                        selector.unregister(one)
                    one.close()


def _bridge(port: int, limits: Mapping[str, Any]) -> dict[str, Any]:
    return {
        "arm": dict(ARM),
        "end": {"plugin": "sim"},
        "state_rate_hz": 250.0,
        "zenoh": {"listen": [f"tcp/127.0.0.1:{port}"], "lease_s": 5.0},
        "limits": dict(limits),
    }


def _free_port(kind: socket.SocketKind = socket.SOCK_STREAM) -> int:
    with socket.socket(type=kind) as probe:
        probe.bind(("127.0.0.1", 0))
        return int(probe.getsockname()[1])
