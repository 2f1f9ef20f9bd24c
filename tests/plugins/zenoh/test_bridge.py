"""What may reach the arms, rule by rule."""

from __future__ import annotations

import itertools

import numpy as np
import pytest
from clothrf_zenoh.attachment import Attachment
from clothrf_zenoh.checks import Reason
from clothrf_zenoh.faults import BridgeRefused
from clothrf_zenoh.state import TRANSITIONS, Event, State, after
from hypothesis import given, settings
from hypothesis import strategies as st

from clothrf_core.errors import RefusedTarget
from clothrf_core.testing.arms import CraneArms

from .conftest import DT, GID, MS, OTHER, ZERO, Bench


def speeds(end):
    return np.array([np.abs(qd).max() for _, qd in end.log])


def moving(bench, speed=0.7):
    """Half speed on joint 3 (a wrist, so no gripper limit is met)."""
    target = ZERO.copy()
    target[3] = 1.3
    limiter = bench.arm.limiter(DT, q=bench.bridge.output[0])
    for _ in range(60):
        q, qd, _ = limiter.tick(target)
        assert bench.command(q, qd) is None
        bench.tick()
    assert np.abs(bench.bridge.output[1][3]) > speed
    return bench


# ---- the way to motion --------------------------------------------------------------------------


def test_the_way_to_motion_is_connect_arm_command(bench):
    seen = [bench.bridge.state]
    bench.tick()
    seen.append(bench.bridge.state)
    bench.arm_it()
    seen.append(bench.bridge.state)
    bench.command()
    seen.append(bench.bridge.state)

    assert seen == [State.DISCONNECTED, State.IDLE, State.ARMED, State.RUNNING]


def test_every_way_into_running_comes_from_armed():
    assert {s for (s, _), t in TRANSITIONS.items() if t is State.RUNNING} == {State.ARMED}


def test_every_way_into_armed_is_the_arm_request():
    assert {e for (_, e), t in TRANSITIONS.items() if t is State.ARMED} == {Event.ARM}


@given(st.lists(st.sampled_from(list(Event)), max_size=40))
def test_after_any_stop_only_a_new_arm_request_leads_to_motion(events):
    state, asked = State.DISCONNECTED, False
    for event in events:
        asked = event is Event.ARM or (
            asked and event in (Event.COMMAND, Event.CONNECTED, Event.CLEAR)
        )
        state = after(state, event)
        assert state is not State.RUNNING or asked


def test_without_a_controller_there_is_no_output(bench):
    bench.end.connected = False

    assert bench.tick() is None
    with pytest.raises(BridgeRefused, match="DISCONNECTED"):
        bench.arm_it()


def test_a_command_before_arming_is_refused(bench):
    bench.tick()

    assert bench.command().reason is Reason.NOT_ARMED


def test_the_arms_go_where_a_paced_stream_leads(running):
    target = np.linspace(-0.5, 0.5, 14)
    target[[0, 1, 2, 7, 8, 9]] = 0.0

    running.run_to(target)

    assert np.allclose(running.bridge.output[0], target, atol=1e-6)


def test_following_the_stopping_point_keeps_the_second_limiter_within_three_ticks(running):
    target = ZERO.copy()
    target[3] = 1.3
    limiter = running.arm.limiter(DT, q=ZERO)
    lag = []
    for _ in range(400):
        q, qd, _ = limiter.tick(target)
        running.command(q, qd)
        out = running.tick()[0]
        if abs(qd[3]) > 0.5:
            lag.append((q[3] - out[3]) / qd[3])

    assert max(lag) < 3 * DT


def test_late_messages_are_caught_up_with_gently(running):
    limiter = CraneArms(speed=0.5).limiter(DT, q=ZERO)
    target = ZERO.copy()
    target[0] = 0.8
    fastest = client = 0.0
    for i in range(600):
        q, qd, _ = limiter.tick(target)
        if not 60 <= i < 80:
            running.command(q, qd)
            client = max(client, abs(qd[0]))
        fastest = max(fastest, abs(running.tick()[1][0]))

    assert running.bridge.state is State.RUNNING
    assert fastest <= 1.3 * client
    assert running.bridge.output[0][0] == pytest.approx(0.8, abs=1e-3)


# ---- commands that must not pass ----------------------------------------------------------------


def bad_q(index, value):
    q = ZERO.copy()
    q[index] = value
    return q


@pytest.mark.parametrize(
    ("options", "reason"),
    [
        ({"q": bad_q(2, np.nan)}, Reason.NOT_FINITE),
        ({"q": bad_q(2, np.inf)}, Reason.NOT_FINITE),
        ({"qd": bad_q(2, np.nan)}, Reason.NOT_FINITE),
        ({"qd": bad_q(2, -np.inf)}, Reason.NOT_FINITE),
        ({"q": bad_q(2, 1e300)}, Reason.JOINT),
        ({"q": bad_q(13, 1.41)}, Reason.JOINT),
        ({"qd": bad_q(0, 1.6)}, Reason.VELOCITY),
        ({"q": bad_q(5, 0.2)}, Reason.JUMP),
        ({"payload": b""}, Reason.MALFORMED),
        ({"payload": b"\x00\x01\x00\x00" + bytes(560)}, Reason.MALFORMED),
        ({"epoch": 6}, Reason.EPOCH),
        ({"epoch": 8}, Reason.EPOCH),
        ({"gid": OTHER}, Reason.FOREIGN),
        ({"step": 0}, Reason.SEQUENCE),
        ({"step": -1}, Reason.SEQUENCE),
        ({"age_ns": 101 * MS}, Reason.STALE),
        ({"age_ns": -21 * MS}, Reason.FUTURE),
        ({"attach": b""}, Reason.ATTACHMENT),
        ({"attach": bytes(33)}, Reason.ATTACHMENT),
    ],
    ids=lambda p: getattr(p, "value", None),
)
def test_a_bad_command_is_refused_counted_and_not_executed(running, options, reason):
    before = running.bridge.output[0].copy()

    refusal = running.command(**options)
    running.tick(10)

    assert refusal.reason is reason
    assert running.bridge.tally.refused == {reason: 1}
    assert np.array_equal(running.bridge.output[0], before)
    assert running.bridge.state is (State.HOLD if refusal.halts else State.RUNNING)


def test_a_stranger_cannot_stop_the_arms(running):
    for _ in range(50):
        running.command(payload=b"rubbish", attach=b"rubbish")
        running.command(bad_q(2, np.nan), gid=OTHER)
        running.command()
        running.tick()

    assert running.bridge.state is State.RUNNING


def test_a_refusal_names_the_joint_what_was_allowed_and_what_was_found(running):
    refusal = running.command(bad_q(13, 1.41))

    assert str(refusal) == (
        "position left_6: expected -1.4000 to 1.4000, found 1.4100 (joint_limit)"
    )


def test_the_first_command_must_begin_where_the_arms_are(bench):
    bench.tick()
    bench.arm_it()

    refusal = bench.command(bad_q(3, 0.1))

    assert refusal.reason is Reason.START
    assert bench.bridge.state is State.HOLD


def test_the_first_command_must_begin_where_the_grippers_are(bench):
    bench.limits = bench.limits.model_copy(update={"start_tcp": 0.001})
    bench.__post_init__()
    bench.tick()
    bench.arm_it()

    refusal = bench.command(bad_q(0, 0.05))

    assert refusal.reason is Reason.START
    assert "gripper" in refusal.expected


def test_sequences_do_not_restart_for_the_same_publisher(running):
    old = Attachment(running.sequence, running.now.wall_ns, GID).encode()
    running.bridge.release(gid=GID, epoch=running.epoch)
    running.tick()
    running.sequence = 0
    running.arm_it()

    refusal = running.command(attach=old)

    assert refusal.reason is Reason.SEQUENCE


def test_clocks_of_two_machines_may_differ(bench):
    bench.tick()
    bench.bridge.request_arms(
        gid=GID, sequence=0, stamp_ns=bench.now.wall_ns - 10**13, lease_s=1.0, now=bench.now
    )
    bench.epoch = 7

    assert bench.command(age_ns=10**13) is None
    assert bench.command(age_ns=10**13 + 101 * MS).reason is Reason.STALE


def test_a_gap_in_the_sequence_is_counted_as_lost(running):
    running.command(step=4)

    assert running.bridge.tally.lost == 3


# ---- silence ------------------------------------------------------------------------------------


def test_silence_is_noticed_within_104_ms_and_the_arms_stop(running):
    moving(running)
    last = running.now_ns

    while running.bridge.state is State.RUNNING:
        running.tick()
    noticed = running.now_ns
    while not running.bridge.at_rest:
        running.tick()

    assert (noticed - last) / MS <= 104
    assert (running.now_ns - noticed) / MS <= 100
    assert running.bridge.tally.stops == {Reason.WATCHDOG: 1}


def test_after_silence_the_same_stream_does_not_move_the_arms_again(running):
    moving(running)
    running.tick(80)
    at = running.bridge.output[0].copy()

    refusals = {running.command(at + 0.01).reason for _ in range(20) if running.tick() is not None}

    assert refusals == {Reason.NOT_ARMED}
    assert np.array_equal(running.bridge.output[0], at)


def test_a_lease_that_is_not_renewed_ends_in_a_stop(bench):
    bench.tick()
    bench.arm_it(lease_s=0.3)
    for _ in range(80):
        bench.command()
        bench.tick()

    assert bench.bridge.state is State.HOLD
    assert bench.bridge.tally.stops == {Reason.LEASE: 1}


def test_a_renewed_lease_lasts(bench):
    bench.tick()
    bench.arm_it(lease_s=0.3)
    for i in range(200):
        bench.command()
        bench.tick()
        if i % 25 == 0:
            bench.bridge.renew(gid=GID, epoch=bench.epoch, now=bench.now)

    assert bench.bridge.state is State.RUNNING


def test_a_pause_of_the_bridge_itself_stops_the_arms(running):
    running.command()
    running.tick(dt_ns=150 * MS)

    assert running.bridge.state is State.HOLD


def test_only_the_holder_may_renew_or_release(running):
    with pytest.raises(BridgeRefused, match="holder"):
        running.bridge.release(gid=OTHER, epoch=running.epoch)
    with pytest.raises(BridgeRefused, match="holder"):
        running.bridge.renew(gid=GID, epoch=running.epoch + 1, now=running.now)


def test_arms_in_use_are_not_granted_to_another(running):
    with pytest.raises(BridgeRefused, match="RUNNING"):
        running.arm_it(gid=OTHER)


def test_moving_arms_are_not_granted(running):
    moving(running)
    running.bridge.release(gid=GID, epoch=running.epoch)
    running.tick()

    with pytest.raises(BridgeRefused, match="at rest"):
        running.arm_it()


# ---- stop ---------------------------------------------------------------------------------------


def test_an_emergency_stop_works_in_one_tick_and_lasts_until_cleared(running):
    moving(running)
    before = running.bridge.output[1][3]
    running.bridge.emergency_stop("test")
    running.tick()
    assert running.bridge.output[1][3] < before

    running.tick(100)
    with pytest.raises(BridgeRefused, match="ESTOP"):
        running.arm_it()
    running.bridge.clear()
    running.tick()
    running.arm_it()

    assert running.bridge.state is State.ARMED


def test_an_emergency_stop_survives_a_restart_of_the_controller(running):
    running.bridge.emergency_stop("test")
    running.end.connected = False
    running.tick(3)
    running.end.connected = True
    running.tick(3)

    assert running.bridge.state is State.ESTOP


def test_a_controller_lost_in_motion_is_a_gentle_stop_before_anything_else(running):
    moving(running)
    running.end.connected = False
    outputs = [running.bridge.output]
    while (out := running.tick()) is not None:
        outputs.append(out)
        assert running.bridge.state is State.HOLD
    v = np.array([qd for _, qd in outputs])

    assert len(outputs) > 5
    assert (np.abs(np.diff(v, axis=0)) <= running.bounds.acceleration * DT + 1e-9).all()
    assert not v[-1].any()
    assert running.bridge.tally.stops == {Reason.CONTROLLER: 1}
    assert running.bridge.state is State.DISCONNECTED
    assert "controller: expected measurements of both arms" in running.bridge.why


def test_a_controller_that_blinks_in_motion_is_stopped_and_begun_anew(running):
    moving(running)
    running.end.connected = False
    running.tick()
    running.end.connected = True
    while not running.bridge.at_rest:
        running.tick()
        assert running.bridge.state is State.HOLD
    stood = running.end.measured()[0]
    running.tick()

    assert running.bridge.state is State.IDLE
    assert np.array_equal(running.bridge.output[0], stood)


def test_cleared_without_a_controller_the_bridge_is_disconnected(running):
    running.bridge.emergency_stop("test")
    running.end.connected = False
    running.tick(3)
    running.bridge.clear()
    running.tick()

    assert running.bridge.state is State.DISCONNECTED


def test_a_controller_that_comes_back_finds_the_arms_where_they_are_and_unarmed(running):
    running.end.connected = False
    running.tick()
    running.end.connected = True
    running.end.put(np.full(14, 0.3), ZERO)
    running.tick()

    assert running.bridge.state is State.IDLE
    assert np.array_equal(running.bridge.output[0], np.full(14, 0.3))
    assert running.command().reason is Reason.NOT_ARMED


def test_arms_that_do_not_follow_are_stopped(running):
    running.command()
    running.now_ns += 4 * MS
    running.bridge.tick(running.now, (np.full(14, 0.4), ZERO))

    assert running.bridge.state is State.HOLD
    assert running.bridge.tally.stops == {Reason.FOLLOWING: 1}


def test_arms_outside_their_soft_limits_are_not_granted(bench):
    bench.end.put(bad_q(4, 1.45), ZERO)
    bench.tick()

    with pytest.raises(BridgeRefused, match="posture right_4"):
        bench.arm_it()


# ---- the output ---------------------------------------------------------------------------------


def towards_each_other(bench):
    """An honest but blind client drives the right gripper into the left one, slowly."""
    limiter = bench.arm.limiter(DT, q=bench.bridge.output[0])
    goal = ZERO.copy()
    goal[0], goal[7] = 1.0, -1.0
    for _ in range(600):
        q, qd, _ = limiter.tick(goal)
        bench.command(q, qd)
        bench.tick()
        yield bench.arm.clearance(bench.bridge.output[0])[0]


def test_the_arms_stop_before_they_touch():
    bench = Bench(CraneArms(speed=0.5)).running()

    least = min(towards_each_other(bench))

    assert least >= bench.limits.clearance
    assert least < 0.06
    assert bench.bridge.state is State.HOLD
    assert list(bench.bridge.tally.stops) == [Reason.CLEARANCE]


def test_the_arms_stop_inside_their_box():
    bench = Bench(CraneArms(speed=0.5))
    bench.limits = bench.limits.model_copy(update={"box_high": [0.42, 0.65, 0.85]})
    bench.__post_init__()
    bench.running()
    limiter = bench.arm.limiter(DT, q=ZERO)
    outputs = []
    for _ in range(400):
        q, qd, _ = limiter.tick(bad_q(2, 1.0))
        bench.command(q, qd)
        outputs.append(bench.arm.grasp_points(bench.tick()[0])[:, 0].max())

    assert 0.415 < max(outputs) <= 0.42
    assert list(bench.bridge.tally.stops) == [Reason.TCP_BOX]


def test_a_gripper_that_is_too_fast_is_stopped(running):
    limiter = running.arm.limiter(DT, q=ZERO)
    fastest = 0.0
    points = running.arm.grasp_points(ZERO)
    for _ in range(200):
        q, qd, _ = limiter.tick(bad_q(7, 1.2))
        running.command(q, qd)
        now = running.arm.grasp_points(running.tick()[0])
        fastest = max(fastest, np.linalg.norm(now - points, axis=1).max() / DT)
        points = now

    assert list(running.bridge.tally.stops) == [Reason.TCP_SPEED]
    assert 0.25 < fastest < 0.3


class LyingLimiter:
    """Gives whatever a test wants as the next motion."""

    at_rest = False

    def __init__(self, *motion):
        self._motion = motion

    def tick(self, target):
        return self._motion

    def stop(self):
        return self._motion


class FailingLimiter(LyingLimiter):
    def tick(self, target):
        raise self._motion[0]


@pytest.mark.parametrize(
    "limiter",
    [
        LyingLimiter(np.full(14, np.nan), ZERO, ZERO),
        LyingLimiter(bad_q(3, 1.45), ZERO, ZERO),
        LyingLimiter(bad_q(3, 0.01), ZERO, ZERO),
        LyingLimiter(ZERO, bad_q(3, 1.6), ZERO),
        LyingLimiter(ZERO, bad_q(3, 0.5), ZERO),
        LyingLimiter(ZERO, ZERO, bad_q(3, 21.0)),
        FailingLimiter(RefusedTarget("no")),
        FailingLimiter(ZeroDivisionError("a bug")),
    ],
)
def test_an_impossible_output_is_never_sent_and_ends_in_a_fault(running, limiter):
    before = running.bridge.output[0].copy()
    running.bridge._limiter = limiter
    running.command()
    running.tick(5)

    assert running.bridge.state is State.FAULT
    assert np.array_equal(running.bridge.output[0], before)
    assert not running.bridge.output[1].any()


@given(seed=st.integers(0, 2**32 - 1))
@settings(max_examples=8, deadline=None)
def test_whatever_the_client_asks_the_output_stays_within_every_limit(seed):
    rng = np.random.default_rng(seed)
    bench = Bench().running()
    arm, bounds = bench.arm, bench.bounds
    q, goal = ZERO, ZERO
    for i in range(300):
        if i % 37 == 0:
            goal = rng.uniform(-1.4, 1.4, 14)
            goal[[0, 1, 2, 7, 8, 9]] *= 0.1
        q = q + np.clip(goal - q, -bounds.velocity * DT, bounds.velocity * DT)
        bench.command(q, rng.uniform(-1.5, 1.5, 14))
        bench.tick()
        if bench.bridge.state is State.HOLD and bench.bridge.at_rest:
            q = bench.bridge.output[0]
            bench.arm_it()
    q = np.array([q for q, _ in bench.end.log])
    v = np.diff(q, axis=0) / DT
    a = np.diff(v, axis=0) / DT
    points = np.array([arm.grasp_points(row) for row in q])

    assert (q >= bounds.lower).all()
    assert (q <= bounds.upper).all()
    assert (np.abs(v) <= bounds.velocity + 1e-6).all()
    assert (np.abs(a) <= bounds.acceleration + 1e-6).all()
    assert np.linalg.norm(np.diff(points, axis=0), axis=2).max() / DT <= bounds.tcp_speed_hard
    assert min(arm.clearance(row)[0] for row in q) >= bounds.clearance


def hostile(bench, rng):
    """One broken or foreign command of any kind."""
    good = bench.payload(np.clip(rng.normal(0, 0.5, 14), -1.4, 1.4))
    sequence = bench.sequence + int(rng.integers(1, 5))
    kind = int(rng.integers(8))
    gid, stamp = GID, bench.now.wall_ns
    if kind == 0:
        gid = rng.bytes(16)
    elif kind == 1:
        sequence = int(rng.integers(-(2**62), bench.sequence + 1))
    elif kind == 2:
        stamp -= int(rng.integers(101 * MS, 2**60))
    elif kind == 3:
        stamp += int(rng.integers(21 * MS, 2**60))
    elif kind == 4:
        good = bench.payload(rng.normal(0, 0.001, 14), epoch=int(rng.integers(1000, 2**32)))
        return Attachment(bench.sequence, stamp, gid).encode(), good
    elif kind == 5:
        return rng.bytes(int(rng.integers(0, 64))), good
    elif kind == 6:
        return None, good
    else:
        return Attachment(sequence, stamp, rng.bytes(16)).encode(), rng.bytes(
            int(rng.integers(0, 700))
        )
    return Attachment(sequence, stamp, gid).encode(), good


def test_of_twenty_thousand_hostile_commands_none_is_executed(running):
    rng = np.random.default_rng(1)
    accepted = running.bridge.tally.accepted
    for i, _ in enumerate(itertools.repeat(None, 20_000)):
        refusal = running.bridge.receive(*hostile(running, rng), running.now)
        assert refusal is not None
        if i % 200 == 0:
            running.command()
            accepted += 1
            running.tick()

    assert running.bridge.tally.accepted == accepted
    assert running.bridge.state is State.RUNNING
    assert not running.bridge.output[0].any()
