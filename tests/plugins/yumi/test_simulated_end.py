"""The simulated end follows exactly as its differential equation says."""

from __future__ import annotations

import numpy as np
from clothrf_yumi.config import SimulatedEndConfig
from clothrf_yumi.simulated_end import SimulatedEnd

from clothrf_core.interfaces import BridgeEnd
from clothrf_core.registry import Registry


class Clock:
    def __init__(self) -> None:
        self.now = 10.0

    def __call__(self) -> float:
        return self.now


def test_it_follows_with_a_first_order_lag():
    clock = Clock()
    with SimulatedEnd(np.zeros(14), lag=0.02, clock=clock) as end:
        end.put(np.ones(14), np.zeros(14))
        clock.now += 0.02
        q, qd = end.measured()
        np.testing.assert_allclose(q, 1.0 - np.exp(-1.0))
        np.testing.assert_allclose(qd, np.exp(-1.0) / 0.02)
        clock.now += 1.0
        np.testing.assert_allclose(end.measured()[0], 1.0)


def test_how_often_it_is_read_does_not_matter():
    ends = []
    for reads in (1, 50):
        clock = Clock()
        with SimulatedEnd(np.zeros(14), lag=0.05, clock=clock) as end:
            end.put(np.ones(14), np.zeros(14))
            for _ in range(reads):
                clock.now += 0.1 / reads
                q, _ = end.measured()
        ends.append(q)
    np.testing.assert_allclose(ends[0], ends[1], rtol=1e-12)


def test_nothing_is_measured_outside_the_context_and_the_arms_stay():
    clock = Clock()
    end = SimulatedEnd(np.zeros(14), lag=0.02, clock=clock)
    assert end.measured() is None
    with end:
        end.put(np.ones(14), np.zeros(14))
        clock.now += 0.01
    assert end.measured() is None
    with end:
        stood, _ = end.measured()
        clock.now += 1.0
        np.testing.assert_array_equal(end.measured()[0], stood)


def test_the_registry_builds_it_at_the_ready_posture():
    end: BridgeEnd = Registry.installed().build("bridge_end", "sim")
    with end:
        q, qd = end.measured()
    arm = Registry.installed().build("arm", "yumi")
    np.testing.assert_array_equal(q, arm.ready)
    np.testing.assert_array_equal(qd, 0.0)
    assert end.health()["connected"] == 0.0


def test_a_start_posture_can_be_given():
    config = SimulatedEndConfig(posture=[0.1] * 14)
    with Registry.installed().build("bridge_end", "sim", config) as end:
        np.testing.assert_array_equal(end.measured()[0], 0.1)
