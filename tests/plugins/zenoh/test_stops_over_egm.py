"""Silence and loss at half speed: the rules, EGM's sockets, two simulated arms, real time."""

from __future__ import annotations

import time

import numpy as np
import pytest
from clothrf_zenoh.bench import ARM
from clothrf_zenoh.checks import Reason
from clothrf_zenoh.compose import choose
from clothrf_zenoh.config import LimitsSection
from clothrf_zenoh.state import State

from clothrf_core.registry import Registry

from .conftest import DT, MS, Bench

pytest.importorskip("pinocchio")
pytest.importorskip("ruckig")
egm = pytest.importorskip("clothrf_egm.end")

from clothrf_egm.config import EgmConfig  # noqa: E402
from clothrf_egm.controller import ControllerModel  # noqa: E402
from clothrf_egm.mapping import from_egm  # noqa: E402
from clothrf_egm.simulator import EgmSimulator  # noqa: E402

LEFT, RIGHT = slice(0, 7), slice(7, 14)
LIMITS = LimitsSection(tcp_speed=1.4, tcp_speed_hard=1.5, following=1.0)


class Cell(Bench):
    """A `Bench` whose far end is EGM on loopback; each tick lasts 4 ms of real time."""

    def tick(self, count=1, **options):
        for _ in range(count):
            out = super().tick(1, **options)
            time.sleep(DT)
        return out

    def swing(self, ticks):
        """Both shoulders and wrists towards one side, as an honest client streams it."""
        goal = self.arm.ready + 0.6 * np.isin(np.arange(14), [0, 6, 7, 13])
        limiter = self.arm.limiter(DT, q=self.bridge.output[0])
        for _ in range(ticks):
            q, qd, _ = limiter.tick(goal)
            assert self.command(q, qd) is None
            self.tick()


def eavesdrop(controller):
    """What that controller is told from now on, one (7,) posture an answer."""
    told, cycle = [], controller.cycle

    def heard(answer, **options):
        if answer is not None:
            told.append(from_egm(answer.joints, answer.external))
        return cycle(answer, **options)

    controller.cycle = heard
    return told


def worst_jerk(speeds, limits):
    """Greatest share of its jerk limit that any joint used, from (N, J) speeds of every tick."""
    return (np.abs(np.diff(speeds, n=2, axis=0)) / DT**2 / limits).max()


@pytest.fixture
def cell():
    registry = Registry.installed()
    arm = registry.build("arm", *choose("arm", "arm", ARM, registry))
    model = ControllerModel(comm_timeout=5.0)
    config = EgmConfig(left_port=0, right_port=0, timeout=0.2)
    bench = Cell(arm, LIMITS)
    with (
        egm.EgmEnd(config) as end,
        EgmSimulator(model, arm.ready, host="127.0.0.1", ports=end.ports) as bench.sim,
    ):
        bench.end = end
        bench.answers = [eavesdrop(controller) for controller in bench.sim.arms]
        deadline = time.monotonic() + 10.0
        while bench.bridge.state is not State.IDLE:
            bench.tick()
            assert time.monotonic() < deadline
        bench.arm_it()
        bench.swing(60)
        assert bench.bridge.state is State.RUNNING
        assert np.abs(bench.bridge.output[1][[0, 7]]).min() > 0.98 * arm.limits.velocity[0]
        yield bench


def test_a_cut_stream_is_stopped_within_its_jerk_and_the_last_answers_hold(cell):
    cut = cell.now_ns
    speeds = [cell.bridge.output[1]]
    while cell.bridge.state is State.RUNNING:
        speeds.append(cell.tick()[1])
    noticed = cell.now_ns
    while not cell.bridge.at_rest:
        speeds.append(cell.tick()[1])
    stood = cell.now_ns
    cell.tick(20)

    assert (noticed - cut) / MS <= 104
    assert (stood - noticed) / MS <= 100
    assert worst_jerk(speeds, cell.arm.limits.jerk) <= 1 + 1e-6
    for told, part in zip(cell.answers, (LEFT, RIGHT), strict=True):
        np.testing.assert_allclose(told[-5:], [cell.bridge.output[0][part]] * 5, rtol=0, atol=1e-12)


def ways():
    return [
        pytest.param(lambda sim: sim.switch_motors(on=False, arms=[0]), id="motors off"),
        pytest.param(lambda sim: sim.restart(0), id="session begun anew"),
        pytest.param(lambda sim: sim.unplug(0), id="cable"),
    ]


@pytest.mark.parametrize("lose_the_left", ways())
def test_the_other_arm_is_stopped_within_its_jerk_and_nothing_starts_again(cell, lose_the_left):
    lose_the_left(cell.sim)
    outputs = []
    for _ in range(400):
        q, qd = cell.bridge.output
        outputs.append((q, qd))
        cell.command(q + DT * qd, qd)  # the client notices nothing
        if cell.tick() is None or not cell.bridge.output[1].any():
            break
    q, qd = (np.array(column)[:, RIGHT] for column in zip(*outputs, strict=True))
    cell.tick(20)

    assert cell.bridge.tally.stops == {Reason.CONTROLLER: 1}
    assert cell.bridge.state in (State.DISCONNECTED, State.IDLE)
    assert np.abs(qd[0]).max() > 1.5
    assert worst_jerk(qd, cell.arm.limits.jerk[RIGHT]) <= 1 + 1e-6
    # The right arm's controller was told this stop and nothing else, and holds its end.
    told = np.array(cell.answers[1][-60:])
    rest = np.array(outputs[-1][0][RIGHT])
    assert np.abs(told[-1] - rest).max() < 0.01
    assert np.abs(told[-1] - told[-10]).max() < 1e-3
    assert len(np.unique(told.round(9), axis=0)) > 5
    assert cell.sim.counters()["right_timeouts"] == 0
    assert cell.command().reason is Reason.NOT_ARMED
