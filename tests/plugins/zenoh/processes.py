"""Real processes on real TCP loopback, with cranes for arms."""

from __future__ import annotations

import contextlib
import os
import socket
import threading
import time
from pathlib import Path

import numpy as np
from clothrf_zenoh.client import BridgeClient
from clothrf_zenoh.config import YumiZenohConfig, ZenohSection
from clothrf_zenoh.process import BridgeProcess
from clothrf_zenoh.robot import StreamedYumi
from clothrf_zenoh.session import keys_of, open_session

from clothrf_core.testing.arms import CraneArms, crane_registry
from clothrf_core.types import RobotCommand

ARM = CraneArms()


def free_port():
    with socket.socket() as probe:
        probe.bind(("127.0.0.1", 0))
        return probe.getsockname()[1]


def bridge_tables(port, **limits):
    """A bridge file for a busy machine: half a second of silence instead of a tenth."""
    patient = {"watchdog_s": 0.5, "max_age_s": 0.5, "max_gap_s": 0.5, **limits}
    return {
        "arm": {"plugin": "crane"},
        "end": {"plugin": "perfect"},
        "realtime_priority": 0,
        "state_rate_hz": 125.0,
        "zenoh": {"listen": [f"tcp/127.0.0.1:{port}"], "lease_s": 2.0},
        "limits": patient,
    }


def bridge(port, **limits):
    return BridgeProcess(bridge_tables(port, **limits), folder=Path(), registry=crane_registry)


def robot(port, *, connect_timeout_s=5.0, lease_s=1.5, deadman_s=1.0, **options):
    config = YumiZenohConfig(
        arm={"plugin": "crane"},
        zenoh=ZenohSection(
            connect=[f"tcp/127.0.0.1:{port}"], lease_s=2.0, connect_timeout_s=connect_timeout_s
        ),
        lease_s=lease_s,
        deadman_s=deadman_s,
        realtime_priority=0,
        **options,
    )
    return StreamedYumi(config, folder=Path(), registry=crane_registry)


@contextlib.contextmanager
def client(port, gid=None, names=ARM.joint_names, **section):
    section = ZenohSection(connect=[f"tcp/127.0.0.1:{port}"], **section)
    with (
        open_session(section, Path()) as session,
        BridgeClient(session, keys_of(section), gid or os.urandom(16), names) as one,
    ):
        yield one


def until(reached, timeout_s=10.0, what="it"):
    """Wait for a fact of another process."""
    deadline = time.monotonic() + timeout_s
    while not reached():
        assert time.monotonic() < deadline, f"waited {timeout_s} s for {what}"
        time.sleep(0.005)


def drive(machine, targets, seconds):
    """30 Hz commands, as the control loop sends them; returns what was really sent."""
    sent = []
    for number in range(int(seconds * 30)):
        command = RobotCommand(number, time.monotonic_ns(), 0.3, np.asarray(targets, float))
        sent.append(machine.send(command))
        time.sleep(1 / 30)
    return sent


def arrive(machine, targets, timeout_s=15.0):
    """Drive until the grippers are there, however busy the machine is; returns what was sent."""
    sent, deadline = [], time.monotonic() + timeout_s
    while np.abs(machine.state().positions - targets).max() > 0.004:
        assert time.monotonic() < deadline, (machine.state().positions, machine.status())
        sent += drive(machine, targets, 0.1)
    return sent


class Relay:
    """A TCP cable between a client and a bridge that can be cut."""

    def __init__(self, port):
        self._port = port
        self._cut = threading.Event()
        self._listener = socket.create_server(("127.0.0.1", 0))
        self.port = self._listener.getsockname()[1]
        self._sockets = [self._listener]
        self._threads = []

    def __enter__(self):
        self._start(self._accept)
        return self

    def __exit__(self, *_):
        for one in self._sockets:
            with contextlib.suppress(OSError):
                one.shutdown(socket.SHUT_RDWR)
            one.close()
        for thread in self._threads:
            thread.join(timeout=2.0)

    def cut(self):
        """From now on nothing gets through, and nobody is told."""
        self._cut.set()

    def _start(self, work, *arguments):
        thread = threading.Thread(target=work, args=arguments, daemon=True)
        self._threads.append(thread)
        thread.start()

    def _accept(self):
        with contextlib.suppress(OSError):
            while True:
                near, _ = self._listener.accept()
                far = socket.create_connection(("127.0.0.1", self._port))
                for one in (near, far):
                    one.setsockopt(socket.IPPROTO_TCP, socket.TCP_NODELAY, 1)
                    self._sockets.append(one)
                self._start(self._copy, near, far)
                self._start(self._copy, far, near)

    def _copy(self, source, sink):
        with contextlib.suppress(OSError):
            while data := source.recv(65536):
                if not self._cut.is_set():
                    sink.sendall(data)
