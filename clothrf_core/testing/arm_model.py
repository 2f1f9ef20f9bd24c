"""What every `ArmModel`, its limiter and every `BridgeEnd` promise."""

from __future__ import annotations

from collections.abc import Callable

import numpy as np

from clothrf_core.errors import RefusedTarget
from clothrf_core.interfaces import ArmModel, BridgeEnd
from clothrf_core.types import Float

DT = 0.004


def check_arm_model(make: Callable[[], ArmModel], *, reach: float = 0.02) -> None:
    """Limits in order, targets approached within them, refusals typed, speeds consistent.

    Args:
        make: builds a fresh model.
        reach: metres that both grippers can move in any direction from the ready posture.

    Raises:
        AssertionError: saying which promise is broken.
    """
    arm = make()
    joints, limits, q = len(arm.joint_names), arm.limits, arm.ready
    assert len(set(arm.joint_names)) == joints, "joint names are not unique"
    for name in ("lower", "upper", "soft_lower", "soft_upper", "velocity", "acceleration", "jerk"):
        assert np.shape(getattr(limits, name)) == (joints,), f"limits.{name} is not (J,)"
    assert np.all(limits.lower <= limits.soft_lower), "soft limits are outside the hard ones"
    assert np.all(limits.soft_upper <= limits.upper), "soft limits are outside the hard ones"
    assert np.all(limits.soft_lower < limits.soft_upper), "soft limits leave no room"
    for bound in (limits.velocity, limits.acceleration, limits.jerk):
        assert np.all(bound > 0.0), "a limit of motion is not positive"
    assert np.all((q >= limits.soft_lower) & (q <= limits.soft_upper)), "ready is outside limits"
    distance, pair = arm.clearance(q)
    assert distance > 0.0, f"ready is in collision: {pair}"
    np.testing.assert_array_equal(make().ready, q, "ready differs from one model to the next")
    _check_motion(arm, q, reach)
    _check_refusals(arm, q)
    _check_speeds(arm, q)
    _check_limiter(arm, q)


def _check_motion(arm: ArmModel, q: Float, reach: float) -> None:
    start, limits = arm.grasp_points(q), arm.limits
    assert start.shape == (2, 3), f"grasp points have shape {start.shape}"
    goal, given = start + [reach, 0.0, reach], q.copy()
    for _ in range(2000):
        after = arm.solve(q, goal, DT)
        assert np.all(np.abs(after - q) <= limits.velocity * DT * (1 + 1e-9)), "too fast"
        assert np.all((after >= limits.soft_lower) & (after <= limits.soft_upper)), "beyond limits"
        q = after
        if np.abs(arm.grasp_points(q) - goal).max() < 1e-3:
            break
    assert np.abs(arm.grasp_points(q) - goal).max() < 1e-3, f"{reach} m away is never reached"
    np.testing.assert_array_equal(given, arm.ready, "solve changed its argument")


def _check_refusals(arm: ArmModel, q: Float) -> None:
    good = arm.grasp_points(q)
    for bad in (good * np.nan, good + np.inf, good + [0.0, 0.0, 5.0]):
        try:
            arm.solve(q, bad, DT)
        except RefusedTarget:
            continue
        raise AssertionError(f"expected RefusedTarget for {bad.tolist()}, got a posture")


def _check_speeds(arm: ArmModel, q: Float) -> None:
    qd = np.linspace(-1.0, 1.0, q.size)
    h = 1e-6
    numeric = (arm.grasp_points(q + h * qd) - arm.grasp_points(q - h * qd)) / (2.0 * h)
    error = np.abs(arm.grasp_speeds(q, qd) - np.linalg.norm(numeric, axis=1)).max()
    assert error < 1e-5, f"grasp speeds differ from the derivative of the points by {error:.1e}"


def _check_limiter(arm: ArmModel, q: Float) -> None:
    limits, limiter = arm.limits, arm.limiter(DT, q=q)
    assert limiter.at_rest, "a fresh limiter is not at rest"
    before = q
    for tick in range(200):
        target = limits.upper + 1.0 if tick < 100 else limits.lower - 1.0
        now, qd, qdd = limiter.tick(target)
        assert np.all((now >= limits.soft_lower) & (now <= limits.soft_upper)), "beyond limits"
        assert np.all(np.abs(qd) <= limits.velocity), "too fast"
        assert np.all(np.abs(qdd) <= limits.acceleration), "too hard"
        assert np.all(np.abs(now - before) <= limits.velocity * DT + 1e-9), "a step"
        before = now
    for _ in range(1000):
        before, _, _ = limiter.stop()
        if limiter.at_rest:
            break
    assert limiter.at_rest, "never stops"
    try:
        limiter.tick(q * np.nan)
    except RefusedTarget:
        np.testing.assert_allclose(limiter.stop()[0], before, rtol=0, atol=1e-9)
        return
    raise AssertionError("expected RefusedTarget for a target that is not finite, got a motion")


def check_bridge_end(make: Callable[[], BridgeEnd], *, joints: int) -> None:
    """It can be entered twice, says nothing it does not know, and never moves by itself."""
    for _ in range(2):
        with make() as end:
            measured = end.measured()
            if measured is not None:
                q, qd = measured
                assert q.shape == qd.shape == (joints,), f"measured {q.shape} and {qd.shape}"
                again = end.measured()
                assert again is not None, "a measurement vanished"
                np.testing.assert_array_equal(again[0], q, "the arms moved by themselves")
                end.put(q, qd)
            else:
                end.put(np.zeros(joints), np.zeros(joints))
            health = end.health()
            assert all(isinstance(value, float) for value in health.values()), f"{health}"
