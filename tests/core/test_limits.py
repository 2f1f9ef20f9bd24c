import numpy as np
import pytest

from clothrf_core.limits import Limits, LimitsSection
from clothrf_core.types import Action, CameraModel, GraspState, Observation, RgbdFrame

GRASP = np.array([[0.40, -0.15, 0.40], [0.40, 0.15, 0.40]])


def command(action, **changes):
    model = CameraModel(4, 4, np.eye(3), np.eye(4))
    depth = np.full((4, 4), np.nan, np.float32)
    frame = RgbdFrame(77, np.zeros((4, 4, 3), np.uint8), depth, model)
    observation = Observation(frame, GraspState(GRASP, 70))
    return Limits(LimitsSection(**changes), dt=0.1).command(action, observation, 5)


def test_a_near_target_is_passed_on():
    sent = command(Action(GRASP + 0.01))
    assert np.allclose(sent.targets, GRASP + 0.01)
    assert sent.held == ""


def test_the_command_answers_the_frame_it_was_made_from():
    sent = command(Action(GRASP))
    assert (sent.stamp_ns, sent.sequence) == (77, 5)


def test_a_far_target_is_approached_at_the_highest_speed():
    sent = command(Action(GRASP + [0.0, 0.0, 0.3]), max_speed=0.5)
    assert np.allclose(np.linalg.norm(sent.targets - GRASP, axis=1), 0.05)


def test_low_confidence_slows_down_in_proportion():
    wanted = GRASP + [0.0, 0.0, 0.3]
    sent = command(Action(wanted, 0.3), max_speed=0.5, slow_below=0.5, hold_below=0.1)
    assert np.allclose(np.linalg.norm(sent.targets - GRASP, axis=1), 0.025)


def test_lower_confidence_holds_and_says_why():
    sent = command(Action(GRASP + 0.1, 0.05), hold_below=0.1)
    assert np.array_equal(sent.targets, GRASP)
    assert sent.held == "confidence 0.05 is too low"


@pytest.mark.parametrize("bad", [np.nan, np.inf, -np.inf])
def test_a_target_that_is_not_finite_holds(bad):
    targets = np.array(GRASP)
    targets[1, 2] = bad
    sent = command(Action(targets))
    assert np.array_equal(sent.targets, GRASP)
    assert sent.held == "targets are not finite"


def test_a_confidence_that_is_not_a_number_holds():
    assert np.array_equal(command(Action(GRASP + 0.01, np.nan)).targets, GRASP)


def test_targets_stay_in_the_box():
    sent = command(Action(GRASP - [0.0, 0.0, 0.4]), low=[0.0, -1.0, 0.38], max_speed=1.5)
    assert sent.targets[:, 2].min() >= 0.38


def test_grippers_are_not_pulled_apart():
    wide = GRASP + [[0.0, -0.2, 0.0], [0.0, 0.2, 0.0]]
    sent = command(Action(wide), max_span=0.32, max_speed=1.5)
    assert np.linalg.norm(sent.targets[1] - sent.targets[0]) <= 0.32 + 1e-12


def test_a_wrong_number_of_targets_holds():
    assert command(Action(GRASP[:1])).held == "expected (2, 3) targets, got (1, 3)"


def test_a_lagging_robot_may_be_led_by_more_than_one_period():
    sent = command(Action(GRASP + [0.0, 0.0, 0.3]), max_speed=0.2, lead_s=0.3)
    assert np.allclose(np.linalg.norm(sent.targets - GRASP, axis=1), 0.06)
