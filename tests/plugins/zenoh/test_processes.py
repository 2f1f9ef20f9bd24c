"""Sender, bridge and controller as processes of their own, over real TCP loopback."""

from __future__ import annotations

import itertools
import os
import signal
import time
from pathlib import Path

import numpy as np
import pytest
from clothrf_zenoh.faults import BridgeRefused, BridgeUnreachable
from clothrf_zenoh.messages import JointTrajectoryCodec, epoch_frame
from clothrf_zenoh.pace import wall_ns

from clothrf_core.types import RobotCommand

from .processes import ARM, Relay, arrive, bridge, client, drive, free_port, robot, until

HOME = ARM.grasp_points(ARM.ready)


@pytest.fixture
def port():
    return free_port()


@pytest.fixture(scope="module")
def shared():
    """The port of one bridge for all tests that leave it as they found it: nobody's, cleared."""
    port = free_port()
    with bridge(port):
        yield port


def still(one):
    one.poll()
    return one.joints is not None and not one.joints.velocities.any()


def stream_pid(machine):
    return machine._process.pid


def in_motion(machine, eye):
    """Send the arms up and down until they are seen to move."""
    for up in itertools.islice(itertools.cycle([0.2] * 30 + [0.0] * 30), 600):
        if machine.status()["stream"] != "streaming":  # a busy machine tripped a watchdog
            machine.arm()
        drive(machine, HOME + [0.0, 0.0, up], 0.034)
        eye.poll()
        if eye.joints.velocities.any():
            return
    raise AssertionError(machine.status())


def watched_stop(port, act):
    """Make the arms move, do `act` to the sender, and see what the bridge makes of it."""
    with bridge(port), client(port) as eye, robot(port) as machine:
        eye.wait_for_bridge(5.0)
        in_motion(machine, eye)
        act(machine)
        until(lambda: eye.poll() is None or eye.status.get("state") == "HOLD", what="HOLD")
        until(lambda: still(eye), what="standstill")
        return dict(eye.status)


def test_a_target_is_reached_and_the_arms_are_given_back(port):
    with bridge(port) as far, client(port) as eye:
        with robot(port) as machine:
            sent = arrive(machine, HOME + [0.05, 0.0, 0.05])
            status = machine.status()
        eye.wait_for_bridge(5.0)
        until(lambda: eye.poll() is None or eye.status.get("state") == "HOLD", what="release")
        why = eye.status["reason"]
    counted = far.last_status

    assert [s.held for s in sent[3:]] == [""] * (len(sent) - 3)
    assert status["stream"] == "streaming"
    assert why == "released"
    assert counted["lost"] == 0
    # A last command may cross the release on its way.
    assert {name for name in counted if name.startswith("refused")} <= {"refused.not_armed"}


def test_a_killed_sender_stops_the_arms(port):
    status = watched_stop(port, lambda m: os.kill(stream_pid(m), signal.SIGKILL))

    assert "watchdog" in status["reason"]


def test_a_stopped_sender_stops_the_arms(port):
    def act(machine):
        os.kill(stream_pid(machine), signal.SIGSTOP)
        machine._process.kill()

    assert "watchdog" in watched_stop(port, act)["reason"]


def test_a_cut_cable_stops_the_arms(port):
    with bridge(port), Relay(port) as cable, client(port) as eye, robot(cable.port) as machine:
        eye.wait_for_bridge(5.0)
        in_motion(machine, eye)
        cable.cut()
        until(lambda: eye.poll() is None or eye.status.get("state") == "HOLD", what="HOLD")
        until(lambda: still(eye), what="standstill")
        machine._process.kill()

    assert "watchdog" in eye.status["reason"]


def test_a_silent_controller_lets_go_of_the_lease(shared):
    with client(shared) as eye, robot(shared) as machine:
        here = machine.state().positions
        drive(machine, here, 0.2)
        until(lambda: eye.poll() is None or eye.status.get("state") == "HOLD", what="HOLD")

        until(lambda: machine.status()["bridge"] == "HOLD", what="news")

        assert "lease" in eye.status["reason"]
        held = machine.send(RobotCommand(99, time.monotonic_ns(), 0.3, here)).held
        assert held.startswith("bridge HOLD")


def test_a_controller_may_take_its_time_before_the_first_command(shared):
    with robot(shared, lease_s=1.0, deadman_s=0.2) as machine:
        time.sleep(1.6)

        assert machine.status()["stream"] == "streaming"


def test_after_a_stop_only_arming_again_moves_the_arms(shared):
    with client(shared) as eye, robot(shared) as machine:
        here = machine.state().positions
        drive(machine, here, 0.2)
        reply = eye.emergency_stop("test")
        assert reply.state == "ESTOP"
        until(lambda: machine.status()["bridge"] == "ESTOP", what="news")
        moved = drive(machine, here + [0.05, 0.0, 0.0], 0.3)
        assert "emergency stop asked for by test" in moved[-1].held
        with pytest.raises(BridgeRefused, match="ESTOP"):
            machine.arm()
        eye.ask("clear")
        machine.arm()

        arrive(machine, here + [0.05, 0.0, 0.0])


def test_a_second_sender_is_refused_and_disturbs_nobody(shared):
    with robot(shared) as machine, client(shared) as other:
        other.wait_for_bridge(5.0)
        with pytest.raises(BridgeRefused, match="expected state IDLE or HOLD"):
            other.arm(0.3)
        other.epoch = int(other.status["epoch"])
        for _ in range(20):
            other.send(np.full(14, 0.5), np.zeros(14))
            time.sleep(0.02)  # the bridge keeps the newest only; each is to be seen
        drive(machine, machine.state().positions, 0.3)

        assert machine.status()["bridge"] == "RUNNING"
        assert int(other.ask("status").status["refused.foreign_publisher"]) > 10


def test_a_target_too_far_away_is_refused_and_said(shared):
    with robot(shared, max_step=0.1) as machine:
        here = machine.state().positions
        drive(machine, here, 0.2)
        drive(machine, here + [0.5, 0.0, 0.0], 0.2)

        assert "expected within 0.1 m of the set-point" in machine.status()["why"]
        assert np.allclose(machine.state().positions, here, atol=1e-3)


def test_a_bridge_that_is_not_there_is_named(port):
    machine = robot(port, connect_timeout_s=0.3)

    with pytest.raises(BridgeUnreachable, match="Is `clothrf bridge` running"):
        machine.__enter__()


def test_a_taken_address_is_an_error_of_one_line(shared):
    with pytest.raises(BridgeUnreachable, match="cannot listen"):
        bridge(shared).__enter__()


def test_loop_health_and_refusals_by_reason_are_published(shared):
    with client(shared) as eye:
        eye.wait_for_bridge(5.0)
        eye.send(np.zeros(14), np.zeros(14))
        until(lambda: eye.poll() is None or "refused.not_armed" in eye.status, what="the refusal")

    late = [float(eye.status[f"lateness_{name}_us"]) for name in ("p50", "p99", "max")]
    assert late == sorted(late)
    assert late[2] > 0.0
    assert int(eye.status["overruns"]) >= 0
    assert eye.status["last_refusal"] == (
        "publisher: expected nobody while not armed, found a command (not_armed)"
    )


def test_a_message_on_the_stop_key_stops_the_arms(shared):
    with client(shared) as eye, robot(shared) as machine:
        drive(machine, machine.state().positions, 0.2)
        eye._session.put(eye._keys.request("estop"), b"")
        until(lambda: eye.poll() is None or eye.status.get("state") == "ESTOP", what="ESTOP")
        eye.ask("clear")


def resident_kb(pid):
    return int(Path(f"/proc/{pid}/statm").read_text().split()[1]) * 4


def test_a_flood_over_the_wire_is_refused_and_memory_stays_flat(port):
    rng = np.random.default_rng(3)
    with bridge(port) as far, robot(port) as machine, client(port) as attacker:
        drive(machine, HOME, 0.3)
        outlet, epoch = attacker._commands, int(attacker.ask("status").epoch)
        codec = JointTrajectoryCodec(ARM.joint_names)
        sizes = []
        for i in range(3000):
            kind = i % 4
            payload = rng.bytes(int(rng.integers(0, 60_000 if kind == 0 else 700)))
            if kind == 1:
                payload = codec.encode(0, epoch_frame(epoch), np.full(14, 0.1), np.zeros(14))
            outlet.put(payload, wall_ns())
            if i % 30 == 0:
                drive(machine, HOME, 0.034)
            if i in (1000, 2999):
                sizes.append(resident_kb(far.pid))
        status = attacker.ask("status").status

        assert not machine.status()["why"] or "watchdog" in machine.status()["why"]
        assert np.allclose(machine.state().positions, HOME, atol=1e-9)
    assert int(status["refused.foreign_publisher"]) > 500
    assert sizes[1] - sizes[0] < 8_000


def test_a_message_beyond_the_size_limit_does_not_reach_the_bridge(port):
    with bridge(port) as far, client(port) as attacker, client(port) as other:
        attacker._commands.put(bytes(5_000_000), wall_ns())
        time.sleep(0.3)

        assert other.ask("status").state == "IDLE"
        assert not [name for name in other.ask("status").status if "refused" in name]
        assert resident_kb(far.pid) < 400_000
