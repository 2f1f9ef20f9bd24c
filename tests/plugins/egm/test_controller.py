"""The simulated arm: lag, speed limits, CommTimeout, restarts, motors off."""

from __future__ import annotations

import numpy as np
from clothrf_egm.controller import CYCLE_S, ControllerModel, SimulatedController
from clothrf_egm.mapping import from_egm, to_egm
from clothrf_egm.messages import SensorMessage, decode_robot

START = np.linspace(-0.3, 0.3, 7)


def answer(q: np.ndarray) -> SensorMessage:
    return SensorMessage(0, 0, *to_egm(q))


def test_it_tells_where_it_is():
    arm = SimulatedController(ControllerModel(), START)
    robot = decode_robot(arm.cycle(None))
    np.testing.assert_allclose(from_egm(robot.joints, robot.external), START, atol=1e-14)
    assert robot.sequence == 0
    assert robot.ready
    assert decode_robot(arm.cycle(None)).sequence == 1


def test_it_follows_with_its_lag():
    arm = SimulatedController(ControllerModel(lag=0.02), START)
    arm.cycle(None)
    for _ in range(5):
        arm.cycle(answer(START + 0.01))
    np.testing.assert_allclose(arm.q, START + 0.01 * (1 - np.exp(-5 * CYCLE_S / 0.02)), atol=1e-12)


def test_it_never_turns_faster_than_its_joints_can():
    model = ControllerModel()
    arm = SimulatedController(model, START)
    arm.cycle(None)
    before = arm.q
    for _ in range(20):
        arm.cycle(answer(START + 3.0))
        assert np.all(arm.q - before <= np.array(model.speed) * CYCLE_S + 1e-12)
        before = arm.q
    np.testing.assert_allclose(arm.q, START + 20 * CYCLE_S * np.array(model.speed), rtol=1e-9)


def test_without_answers_the_session_ends_and_a_new_one_begins_where_it_is():
    arm = SimulatedController(ControllerModel(comm_timeout=0.1, restart=0.2), START)
    arm.cycle(None)
    for _ in range(10):
        arm.cycle(answer(START + 1.0))
    requests = [arm.cycle(None) for _ in range(26)]
    assert requests[20] is not None
    assert requests[-1] is None
    stood = arm.q
    assert not arm.running
    silent = 0
    while (request := arm.cycle(answer(START + 1.0))) is None:
        silent += 1
    np.testing.assert_array_equal(arm.q, stood)
    assert abs(silent * CYCLE_S - 0.2) < 0.02
    assert decode_robot(request).sequence == 0
    assert arm.counters.timeouts == 1


def test_motors_off_it_stands_and_says_so():
    arm = SimulatedController(ControllerModel(), START)
    arm.cycle(None)
    arm.motors = False
    robot = decode_robot(arm.cycle(answer(START + 0.1)))
    assert not robot.ready
    np.testing.assert_array_equal(arm.q, START)


def test_late_answers_count_as_late_and_still_keep_the_session():
    arm = SimulatedController(ControllerModel(comm_timeout=0.05), START)
    arm.cycle(None)
    for _ in range(50):
        assert arm.cycle(answer(START), in_time=False) is not None
    assert arm.counters.same_cycle == 0
    assert arm.counters.timeouts == 0


def test_the_greatest_commanded_step_is_recorded():
    arm = SimulatedController(ControllerModel(), START)
    arm.cycle(None)
    for offset in (0.2, 0.201, 0.251, 0.252):
        arm.cycle(answer(START + offset))
    np.testing.assert_allclose(arm.counters.step, 0.05, rtol=1e-9)
