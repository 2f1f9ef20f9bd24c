"""The bridge end over real UDP sockets on loopback, against simulated controllers."""

from __future__ import annotations

import socket
import time
from collections.abc import Callable, Iterator

import numpy as np
import pytest
from clothrf_egm.config import EgmConfig
from clothrf_egm.controller import ControllerModel
from clothrf_egm.end import EgmEnd
from clothrf_egm.simulator import EgmSimulator
from pydantic import ValidationError

from clothrf_core.errors import ClothrfError
from clothrf_core.registry import Registry
from clothrf_core.testing.arm_model import check_bridge_end

START = np.linspace(-0.3, 0.3, 14)
ZERO = np.zeros(14)
# Generous times: the machine may be busy with other things.
CONFIG = EgmConfig(left_port=0, right_port=0, timeout=3.0, silence=0.5)
MODEL = ControllerModel(comm_timeout=5.0, restart=0.1)


def until(condition: Callable[[], bool], seconds: float = 20.0) -> None:
    end = time.monotonic() + seconds
    while not condition():
        assert time.monotonic() < end, "it never came"
        time.sleep(0.002)


def simulator(end: EgmEnd, model: ControllerModel = MODEL) -> EgmSimulator:
    return EgmSimulator(model, START, host="127.0.0.1", ports=end.ports)


@pytest.fixture
def end() -> Iterator[EgmEnd]:
    with EgmEnd(CONFIG) as entered:
        yield entered


def connected(end: EgmEnd) -> np.ndarray:
    until(lambda: end.measured() is not None)
    measured = end.measured()
    assert measured is not None
    return measured[0]


def lead(end: EgmEnd, sim: EgmSimulator, goal: np.ndarray) -> None:
    """Put postures towards `goal` until the arms are there."""
    q = connected(end)

    def step() -> bool:
        nonlocal q
        q = q + np.clip(goal - q, -0.01, 0.01)
        end.put(q, ZERO)
        return bool(np.abs(sim.q - goal).max() < 1e-6)

    until(step)


def test_both_arms_follow_what_is_put(end):
    with simulator(end) as sim:
        np.testing.assert_allclose(connected(end), START, atol=1e-12)
        lead(end, sim, START + 0.05)
        q, qd = end.measured()
        np.testing.assert_allclose(q, START + 0.05, atol=1e-5)
        np.testing.assert_allclose(qd, 0.0, atol=1e-2)
    health = end.health()
    assert health["left_requests"] > 0
    assert health["right_requests"] > 0
    assert health["left_broken"] == health["left_foreign"] == 0


def test_nothing_is_measured_before_a_controller_speaks(end):
    assert end.measured() is None
    end.put(START, ZERO)
    assert end.health()["refused"] == 1
    assert end.health()["left_age"] == float("inf")


def test_arms_do_not_move_before_something_is_put(end):
    with simulator(end) as sim:
        connected(end)
        time.sleep(0.1)
        np.testing.assert_allclose(sim.q, START, atol=1e-12)


def test_a_first_posture_far_from_the_arms_moves_neither(end):
    with simulator(end) as sim:
        connected(end)
        far = START.copy()
        far[3] += 0.5  # only the left arm's
        for _ in range(20):
            end.put(far, ZERO)
            time.sleep(0.004)
        np.testing.assert_allclose(sim.q, START, atol=1e-12)
    assert end.health()["refused"] == 20


def test_a_restarted_session_takes_the_old_motion_back(end):
    with simulator(end) as sim:
        lead(end, sim, START + 0.05)
        seen = end.health()["left_sessions"]
        sim.restart(0)
        until(lambda: end.health()["left_sessions"] > seen)
        for _ in range(10):
            end.put(START + 0.09, ZERO)
            time.sleep(0.004)
        assert end.health()["refused"] >= 10
        np.testing.assert_allclose(sim.q, START + 0.05, atol=1e-5)
        assert end.measured() is None, "the restart shows once"
        np.testing.assert_allclose(connected(end), START + 0.05, atol=1e-5)


def test_motors_off_and_on_again(end):
    with simulator(end) as sim:
        lead(end, sim, START + 0.05)
        sim.switch_motors(on=False)
        until(lambda: end.health()["left_ready"] == 0.0 and end.health()["right_ready"] == 0.0)
        assert end.measured() is None
        end.put(START, ZERO)
        time.sleep(0.05)
        np.testing.assert_allclose(sim.q, START + 0.05, atol=1e-5)
        sim.switch_motors(on=True)
        np.testing.assert_allclose(connected(end), START + 0.05, atol=1e-5)
        lead(end, sim, START)


def test_a_silent_bridge_leaves_the_arms_where_they_were_told(end):
    with simulator(end) as sim:
        lead(end, sim, START + 0.05)
        end.put(START + 0.06, np.full(14, 0.5))
        until(lambda: end.health()["left_silent"] > 20)
        np.testing.assert_allclose(sim.q, START + 0.06, atol=1e-6)
        assert sim.counters()["left_timeouts"] == 0, "it goes on answering"


def test_when_the_bridge_dies_the_controller_times_out_and_begins_anew():
    model = ControllerModel(comm_timeout=0.1, restart=0.1)
    with EgmEnd(CONFIG) as first:
        ports = first.ports
        sim = simulator(first, model)
        sim.__enter__()
        connected(first)
    try:
        until(lambda: sim.counters()["left_timeouts"] > 0)
        again = EgmConfig(left_port=ports[0], right_port=ports[1], timeout=3.0)
        with EgmEnd(again) as second:
            np.testing.assert_allclose(connected(second), START, atol=1e-9)
    finally:
        sim.__exit__(None, None, None)


def test_bytes_from_elsewhere_are_counted_and_harmless(end):
    with simulator(end) as sim, socket.socket(socket.AF_INET, socket.SOCK_DGRAM) as stranger:
        lead(end, sim, START + 0.02)
        stranger.setblocking(False)
        for data in (b"", b"\x00", b"\xff" * 100, b"x" * 60_000):
            stranger.sendto(data, ("127.0.0.1", end.ports[0]))
        until(lambda: end.health()["left_broken"] >= 4)
        with pytest.raises(BlockingIOError):
            stranger.recv(10)
        lead(end, sim, START)


def test_only_the_configured_controller_is_answered():
    config = EgmConfig(left_port=0, right_port=0, controller="192.0.2.1")
    with EgmEnd(config) as end, simulator(end):
        until(lambda: end.health()["left_foreign"] > 3)
        assert end.health()["left_requests"] == 0


@pytest.mark.parametrize("host", ["0.0.0.0", "192.168.125.50"])
def test_beyond_this_machine_the_controller_must_be_named(host):
    with pytest.raises(ValidationError, match="controller: expected the controller's address"):
        EgmConfig(host=host)
    assert EgmConfig(host=host, controller="192.168.125.1").controller == "192.168.125.1"


@pytest.mark.parametrize("host", ["robot", "", "300.1.1.1", "::1"])
def test_a_host_that_is_no_address_is_an_error(host):
    with pytest.raises(ValidationError, match="host: expected an IPv4 address, found"):
        EgmConfig(host=host)


def test_a_port_in_use_is_an_error_that_says_so():
    with EgmEnd(CONFIG) as first:
        config = EgmConfig(left_port=first.ports[0], right_port=0)
        with pytest.raises(ClothrfError, match="expected a free UDP port"), EgmEnd(config):
            pass


def test_leaving_twice_and_entering_again_is_fine():
    end = EgmEnd(CONFIG)
    for _ in range(2):
        with end:
            assert len(set(end.ports)) == 2
    end.__exit__(None, None, None)


@pytest.mark.parametrize(
    ("q", "qd"),
    [(START[:7], ZERO), (START, ZERO[:7]), (START * np.nan, ZERO), (START, ZERO + np.inf)],
)
def test_broken_postures_are_refused_and_the_last_is_held(end, q, qd):
    with simulator(end) as sim:
        lead(end, sim, START + 0.01)
        with pytest.raises(ClothrfError, match="egm: expected"):
            end.put(q, qd)
        time.sleep(0.02)
        np.testing.assert_allclose(sim.q, START + 0.01, atol=1e-5)


def test_it_keeps_the_contract_of_bridge_ends():
    check_bridge_end(lambda: EgmEnd(CONFIG), joints=14)


def test_the_registry_builds_it_and_it_listens_on_loopback_by_default():
    end = Registry.installed().build("bridge_end", "egm", CONFIG)
    with end:
        assert end._sockets[0].getsockname()[0] == "127.0.0.1"
    assert EgmConfig().host == "127.0.0.1"
    assert (EgmConfig().left_port, EgmConfig().right_port) == (6511, 6512)
