"""The sending side, without a network: follower, mailbox, pace."""

from __future__ import annotations

import multiprocessing
import threading

import numpy as np
import pytest
from clothrf_zenoh.follower import Follower
from clothrf_zenoh.mailbox import Mailbox, News, Wish
from clothrf_zenoh.pace import Pace, Ring

from clothrf_core.clock import ManualClock
from clothrf_core.errors import RefusedTarget
from clothrf_core.testing.arms import CraneArms

from .conftest import DT

ARM = CraneArms()
HOME = ARM.grasp_points(ARM.ready)


@pytest.fixture
def follower():
    return Follower(ARM, dt=DT, q=ARM.ready, tcp_speed=0.2, max_step=0.3)


def test_targets_are_reached(follower):
    goal = HOME + [[0.05, 0.0, 0.02], [0.0, 0.05, -0.05]]
    follower.aim(goal)
    for _ in range(200):
        q, _ = follower.tick()

    assert np.allclose(ARM.grasp_points(q), goal, atol=1e-6)


def test_grippers_keep_the_speed_and_arrive_together():
    follower = Follower(ARM, dt=DT, q=ARM.ready, tcp_speed=0.1, max_step=0.3)
    goal = HOME + [[0.1, 0.0, 0.0], [0.02, 0.0, 0.0]]
    follower.aim(goal)
    points = []
    for _ in range(200):
        points.append(ARM.grasp_points(follower.tick()[0]))
    way = np.diff(points, axis=0)
    share = (points[120] - HOME)[:, 0] / (goal - HOME)[:, 0]

    assert np.linalg.norm(way, axis=2).max() / DT < 0.12
    assert 0.2 < share[0] == pytest.approx(share[1], abs=0.05)


def test_the_set_point_waits_for_joints_that_are_too_slow():
    slow = CraneArms(speed=0.2)
    follower = Follower(slow, dt=DT, q=slow.ready, tcp_speed=0.2, max_step=0.3)
    follower.aim(HOME + [0.1, 0.0, 0.0])
    for _ in range(300):
        follower.tick()
    follower.aim(HOME)
    for _ in range(50):
        q, _ = follower.tick()

    assert slow.grasp_points(q)[0, 0] < HOME[0, 0] + 0.024


def test_halt_stops_and_keeps_the_place(follower):
    follower.aim(HOME + [0.1, 0.0, 0.0])
    for _ in range(50):
        follower.tick()
    follower.halt()
    for _ in range(50):
        q, qd = follower.tick()

    assert follower.at_rest
    assert not qd.any()
    assert 0.0 < ARM.grasp_points(q)[0, 0] - HOME[0, 0] < 0.1


@pytest.mark.parametrize("bad", [np.full((2, 3), np.nan), HOME + 0.5])
def test_a_target_that_jumps_is_refused_and_the_arms_stop(follower, bad):
    follower.aim(HOME + [0.1, 0.0, 0.0])
    for _ in range(20):
        follower.tick()

    with pytest.raises(RefusedTarget, match="set-point"):
        follower.aim(bad)
    for _ in range(50):
        follower.tick()

    assert follower.at_rest


def test_an_unreachable_target_stops_the_arms_at_the_border(follower):
    follower.aim(HOME + [0.2, 0.0, 0.0])

    def go_on():
        for _ in range(500):
            follower.tick()

    with pytest.raises(RefusedTarget, match="in reach"):
        go_on()
    for _ in range(50):
        q, _ = follower.tick()

    assert follower.at_rest
    assert q[2] <= ARM.limits.soft_upper[2]


def test_a_wish_and_news_come_back_as_they_went():
    wish = Wish(3, 5, 0.1, 2, False, True, np.arange(6.0).reshape(2, 3))
    news = News("streaming", "RUNNING", "because", 7, np.ones((2, 3)), 1, 2, 3, 250.0, 80.0, 0.05)

    again = Wish.decode(wish.encode())
    heard = News.decode(news.encode())

    assert again.targets.tolist() == wish.targets.tolist()
    assert (again.number, again.hold, again.leave) == (3, False, True)
    assert (heard.phase, heard.bridge, heard.why) == ("streaming", "RUNNING", "because")
    assert heard.least_clearance == 0.05


def test_a_long_reason_is_cut_and_does_not_break_a_character():
    assert News.decode(News(why="ä" * 600).encode()).why.startswith("ää")


def test_a_mailbox_is_never_half_read():
    box = Mailbox(multiprocessing.get_context("spawn"), 4096)
    assert box.get() is None
    stop = threading.Event()

    def write():
        for i in range(200_000):
            box.put(bytes([i % 256]) * 4096)
            if stop.is_set():
                return

    writer = threading.Thread(target=write)
    writer.start()
    values = [box.get() for _ in range(2000)]
    stop.set()
    writer.join()

    assert all(len(set(value)) == 1 for value in values if value is not None)


def test_a_mailbox_refuses_another_size():
    with pytest.raises(ValueError, match="expected 8 bytes, found 4"):
        Mailbox(multiprocessing.get_context("spawn"), 8).put(b"abcd")


def test_a_late_tick_is_counted_and_not_made_up():
    clock = ManualClock(0)
    pace = Pace(clock, 250.0)
    starts = [pace.wait()]
    clock.sleep_until_ns(30_000_000)
    starts += [pace.wait(), pace.wait()]

    assert starts == [4_000_000, 30_000_000, 34_000_000]
    assert pace.overruns == 1
    assert pace.lateness.spread().max == 22_000.0


def test_a_ring_forgets():
    ring = Ring(4)
    for value in (9_000_000, 1000, 2000, 3000, 4000):
        ring.add(value)

    assert ring.spread().max == 4.0
