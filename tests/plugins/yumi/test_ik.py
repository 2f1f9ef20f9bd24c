"""Inverse kinematics: exact bounds, distances kept, refusals, and a plain solver as oracle."""

from __future__ import annotations

import numpy as np
import pytest

from clothrf_core.errors import RefusedTarget

pin = pytest.importorskip("pinocchio")

from clothrf_yumi.arm import Yumi  # noqa: E402
from clothrf_yumi.config import YumiConfig  # noqa: E402
from clothrf_yumi.posture import REST_GRASP, Stance  # noqa: E402

REST = np.array(REST_GRASP)
STANCE = Stance(YumiConfig().pitch, YumiConfig().lean, float(REST[:, 0].mean()))
DT = 1.0 / 30.0


def yumi(**options: object) -> Yumi:
    config = YumiConfig.model_validate({"profile": "normal", "clearance": 0.015, **options})
    return Yumi(config, corners=REST, table_height=-0.02)


@pytest.fixture(scope="module")
def arm() -> Yumi:
    return yumi()


def walk(arm: Yumi, q: np.ndarray, goal: np.ndarray, *, steps: int, dt: float = DT) -> np.ndarray:
    """Follow targets that move 2 cm a step at most towards `goal`; the last posture."""
    for _ in range(steps):
        points = arm.grasp_points(q)
        gap = goal - points
        length = np.linalg.norm(gap, axis=1, keepdims=True)
        q = arm.solve(q, points + gap * np.minimum(1.0, 0.02 / np.maximum(length, 1e-9)), dt)
    return q


def damped_least_squares(arm: Yumi, q: np.ndarray, goal: np.ndarray) -> np.ndarray:
    """Buss 2004, equation 11, both tool poses at once, without any limits: the oracle."""
    kinematics = arm._kinematics
    wanted = STANCE.rotations(goal)
    for _ in range(200):
        kinematics.update(q)
        J = kinematics.grasp_jacobian()
        turns = [pin.log3(R @ now.T) for R, now in zip(wanted, kinematics.rotations(), strict=True)]
        error = np.concatenate([(goal - kinematics.points).ravel(), *turns])
        q = q + J.T @ np.linalg.solve(J @ J.T + 1e-6 * np.eye(12), error)
    return q


def test_targets_within_10_cm_of_rest_are_reached_with_distance_and_limits_kept(arm):
    rng = np.random.default_rng(0)
    q = arm.ready
    for _ in range(12):
        goal = REST + rng.uniform(-0.1, 0.1, (2, 3))
        q = walk(arm, q, goal, steps=40)
        np.testing.assert_allclose(arm.grasp_points(q), goal, rtol=0, atol=1e-4)
        assert arm.clearance(q)[0] > 0.0145
        assert np.all(q >= arm.limits.soft_lower)
        assert np.all(q <= arm.limits.soft_upper)


def test_the_pose_equals_that_of_damped_least_squares_where_no_limit_matters(arm):
    rng = np.random.default_rng(1)
    for _ in range(5):
        goal = REST + rng.uniform(-0.04, 0.04, (2, 3))
        ours = walk(arm, arm.ready, goal, steps=60)
        arm._kinematics.update(ours)
        points = arm._kinematics.points.copy()
        rotations = [R.copy() for R in arm._kinematics.rotations()]

        damped_least_squares(arm, arm.ready, goal)

        np.testing.assert_allclose(points, arm._kinematics.points, rtol=0, atol=1e-4)
        for R, oracle in zip(rotations, arm._kinematics.rotations(), strict=True):
            np.testing.assert_allclose(R, oracle, rtol=0, atol=2e-3)


def test_one_small_step_equals_the_normal_equations(arm):
    q, dt = arm.ready, 0.004
    goal = arm.grasp_points(q) + [[2e-4, 1e-4, -2e-4], [-1e-4, 2e-4, 1e-4]]
    kinematics, weight = arm._kinematics, YumiConfig().orientation
    kinematics.update(q)
    gaps = (goal - kinematics.points).ravel()
    wanted = STANCE.rotations(goal)
    turns = [pin.log3(R @ now.T) for R, now in zip(wanted, kinematics.rotations(), strict=True)]
    J, error = kinematics.grasp_jacobian(), np.concatenate([gaps, *turns])
    scale = np.repeat([1.0, weight], 6)
    J, error = J * scale[:, None], error * scale
    damping = 1e-6 + 1e-6 + 1e-2 * gaps @ gaps
    step = np.linalg.solve(J.T @ J + damping * np.eye(14), J.T @ error)

    np.testing.assert_allclose(arm.solve(q, goal, dt), q + step, rtol=0, atol=1e-9)


@pytest.mark.parametrize("dt", [0.004, DT])
def test_no_joint_ever_turns_faster_than_its_limit(arm, dt):
    rng = np.random.default_rng(2)
    q, fastest = arm.ready, 0.0
    room = arm.limits.velocity * dt
    for _ in range(60):
        points = arm.grasp_points(q)
        target = np.clip(points + rng.uniform(-0.055, 0.055, (2, 3)), REST - 0.08, REST + 0.08)
        if np.linalg.norm(target - points, axis=1).max() > 0.0999:
            continue
        after = arm.solve(q, target, dt)
        assert np.all(np.abs(after - q) <= room * (1 + 1e-12))
        fastest = max(fastest, float(np.max(np.abs(after - q) / room)))
        q = after
    assert fastest > 0.999


def test_soft_limits_hold_exactly_when_pushed_against(arm):
    # The right arm stretches forward and down until joints end; refused then, never crossed.
    q, touched = arm.ready, False
    for _ in range(200):
        points = arm.grasp_points(q)
        try:
            q = arm.solve(q, points + [[0.01, -0.02, -0.01], [0.0, 0.0, 0.0]], DT)
        except RefusedTarget:
            break
        assert np.all(q >= arm.limits.soft_lower)
        assert np.all(q <= arm.limits.soft_upper)
        touched |= bool(np.any((q == arm.limits.soft_lower) | (q == arm.limits.soft_upper)))
    else:
        pytest.fail("the arm stretches without end")


def test_a_posture_outside_the_soft_limits_goes_back_inside():
    arm = yumi(orientation=0.0)
    q = arm.ready
    q[5] = arm.limits.soft_upper[5] + 0.01
    goal = arm.grasp_points(q)
    for _ in range(3):
        q = arm.solve(q, goal, DT)
    assert np.all(q <= arm.limits.soft_upper)


def test_grippers_pushed_through_each_other_stay_apart(arm):
    rng = np.random.default_rng(3)
    least, refusals = 1.0, []
    for _ in range(4):
        q = arm.ready
        goal = REST[::-1] + rng.uniform(-0.05, 0.05, (2, 3))  # each to the other's place
        for _ in range(40):
            points = arm.grasp_points(q)
            gap = goal - points
            length = np.linalg.norm(gap, axis=1, keepdims=True)
            try:
                q = arm.solve(q, points + gap * np.minimum(1.0, 0.03 / length), DT)
            except RefusedTarget as refusal:
                refusals.append(str(refusal))
                break
            least = min(least, arm.clearance(q)[0])
        else:
            pytest.fail("the arms passed through each other")
    assert 0.0145 - 1e-12 <= least < 0.02
    assert all("blocked by" in refusal for refusal in refusals), refusals


def test_arms_already_too_close_may_only_part(arm):
    tight = yumi(clearance=0.0)
    q = tight.ready
    toward = np.array([[0.0, 0.01, 0.0], [0.0, -0.01, 0.0]])
    for _ in range(60):
        if tight.clearance(q)[0] < 0.008:
            break
        q = tight.solve(q, tight.grasp_points(q) + toward, DT)
    close = arm.clearance(q)[0]
    assert close < 0.015

    stay = arm.solve(q, arm.grasp_points(q) + 0.5 * toward, DT)
    part = arm.solve(q, arm.grasp_points(q) - toward, DT)

    assert arm.clearance(stay)[0] >= close
    assert arm.clearance(part)[0] > close


def test_without_orientation_weight_the_tools_turn_freely():
    free, held = yumi(orientation=0.0), yumi(orientation=0.3)
    goal = REST + [[-0.08, -0.05, 0.08], [-0.08, 0.05, 0.08]]

    def turned(arm: Yumi) -> float:
        arm._kinematics.update(walk(arm, arm.ready, goal, steps=60))
        wanted = STANCE.rotations(goal)
        now = arm._kinematics.rotations()
        return max(float(np.linalg.norm(pin.log3(a @ b.T))) for a, b in zip(wanted, now))  # noqa: B905

    assert turned(held) < 0.01
    assert turned(free) > 0.05


def test_elbows_return_to_the_ready_posture(arm):
    # Standing still, only the posture task moves the arms: the grippers stay.
    q = walk(arm, arm.ready, REST + 0.05, steps=30)
    q = walk(arm, q, REST, steps=30)
    before = np.abs(q - arm.ready).max()
    for _ in range(150):
        q = arm.solve(q, REST, DT)
    assert np.abs(q - arm.ready).max() < max(0.2 * before, 1e-3)
    np.testing.assert_allclose(arm.grasp_points(q), REST, rtol=0, atol=1e-4)


def test_the_answer_does_not_depend_on_what_was_asked_before(arm):
    used = walk(arm, arm.ready, REST + 0.06, steps=10)
    target = arm.grasp_points(used) + 0.004
    answer, fresh = arm.solve(used, target, DT), yumi().solve(used, target, DT)
    np.testing.assert_allclose(answer, fresh, rtol=0, atol=1e-12)


def check_random_walks(seed: int, solves: int) -> None:
    """Any step to anywhere from anywhere: within limits, apart, or a typed refusal."""
    rng = np.random.default_rng(seed)
    arm = yumi(orientation=rng.choice([0.0, 0.05, 0.3]))
    limits, q, done = arm.limits, arm.ready, 0
    while done < solves:
        if rng.random() < 0.05:
            anywhere = rng.uniform(limits.soft_lower, limits.soft_upper)
            q = anywhere if arm.clearance(anywhere)[0] > 0.02 else arm.ready
        dt = rng.choice([0.004, DT, 0.2])
        way = rng.normal(size=(2, 3))
        way *= rng.choice([0.002, 0.02, 0.095]) / np.linalg.norm(way, axis=1, keepdims=True)
        for _ in range(int(rng.integers(1, 12))):
            before = arm.clearance(q)[0]
            done += 1
            try:
                after = arm.solve(q, arm.grasp_points(q) + way, dt)
            except RefusedTarget:
                break
            assert np.all(np.abs(after - q) <= limits.velocity * dt * (1 + 1e-12))
            assert np.all(after >= limits.soft_lower)
            assert np.all(after <= limits.soft_upper)
            assert arm.clearance(after)[0] >= min(before, 0.0145) - 1e-9
            q = after


def test_random_walks_break_no_promise():
    check_random_walks(seed=4, solves=1500)


@pytest.mark.slow
@pytest.mark.parametrize("seed", range(5, 9))
def test_long_random_walks_break_no_promise(seed):
    check_random_walks(seed, solves=15_000)


def refusal(arm: Yumi, targets: np.ndarray) -> str:
    q = arm.ready
    with pytest.raises(RefusedTarget) as caught:
        arm.solve(q, targets, DT)
    np.testing.assert_array_equal(q, arm.ready)
    return str(caught.value)


def test_a_jump_is_refused(arm):
    assert refusal(arm, REST + [[0.0, 0.0, 0.0], [0.0, 0.0, 0.12]]) == (
        "targets[1]: expected at most 0.1 m from the gripper, got 0.120 m; approach it in smaller "
        "steps"
    )


@pytest.mark.parametrize("bad", [np.nan, np.inf, -np.inf])
def test_numbers_that_are_not_finite_are_refused(arm, bad):
    targets = REST.copy()
    targets[1, 2] = bad
    assert "targets" in refusal(arm, targets)


def test_a_wrong_shape_is_refused(arm):
    assert refusal(arm, REST[:1]) == "targets: expected shape (2, 3), got (1, 3)"


def test_a_target_outside_the_box_is_refused(arm):
    narrow = yumi(box_high=[0.75, 0.60, 0.50])
    assert refusal(narrow, REST + [0.0, 0.0, 0.05]).startswith(
        "targets[0]: expected a point between [0.1, -0.6, 0.0] and [0.75, 0.6, 0.5], got "
        "[0.492, -0.15, 0.525]"
    )


@pytest.mark.parametrize("dt", [0.004, DT])
@pytest.mark.parametrize("profile", ["normal", "commissioning"])
def test_a_point_out_of_reach_is_refused_and_the_arms_hold(profile, dt):
    arm = yumi(profile=profile, box_high=[1.5, 0.6, 1.5])
    # Forward from stretched arms: approach until the arms can no more.
    q = arm.ready
    away = np.array([[0.03, 0.0, 0.0], [0.03, 0.0, 0.0]])
    for _ in range(int(20 / dt)):
        try:
            q = arm.solve(q, arm.grasp_points(q) + away, dt)
        except RefusedTarget as refusal:
            message = str(refusal)
            break
    else:
        pytest.fail("never refused")
    assert "expected a point within reach" in message
    assert "the gripper stays" in message
    assert arm.grasp_points(q)[:, 0].min() > 0.5
