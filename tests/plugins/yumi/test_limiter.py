"""The limiter keeps every bound exactly, whatever it is asked for."""

from __future__ import annotations

import ast
from pathlib import Path

import numpy as np
import pytest

pytest.importorskip("ruckig")

from clothrf_yumi import limiter as module
from clothrf_yumi.limiter import RuckigLimiter
from clothrf_yumi.limits import Limits

from clothrf_core.errors import ConfigError, RefusedTarget

DT = 0.004
PROFILES = ("normal", "commissioning")


def middle(limits: Limits) -> np.ndarray:
    return (limits.soft_lower + limits.soft_upper) / 2.0


def check_random_targets(profile: str, ticks: int, seed: int) -> None:
    """Random targets, far beyond the joint limits too, and stops in between; no tolerance."""
    rng = np.random.default_rng(seed)
    limits = Limits.of(profile)
    q0 = rng.uniform(limits.soft_lower, limits.soft_upper)
    limiter = RuckigLimiter(limits, DT, q=q0)
    span = limits.upper - limits.lower
    target, left, stopping = q0, 0, False
    before = (q0, np.zeros(14), np.zeros(14))
    extremes = np.zeros(4)
    for _ in range(ticks):
        if left == 0:
            left = int(rng.integers(1, 60)) * (10 if rng.random() < 0.1 else 1)
            stopping = rng.random() < 0.2
            scale = rng.choice([0.02, 0.3, 1.5])
            target = before[0] + scale * span * rng.uniform(-1.0, 1.0, 14)
        left -= 1
        q, qd, qdd = limiter.stop() if stopping else limiter.tick(target)
        jerk = (qdd - before[2]) / DT
        assert np.all(q >= limits.soft_lower)
        assert np.all(q <= limits.soft_upper)
        assert np.all(np.abs(qd) <= limits.velocity)
        assert np.all(np.abs(qdd) <= limits.acceleration)
        assert np.all(np.abs(jerk) <= limits.jerk)
        assert np.all(np.abs(q - before[0]) <= limits.velocity * DT)
        extremes = np.maximum(
            extremes,
            [
                np.max(np.abs(qd) / limits.velocity),
                np.max(np.abs(qdd) / limits.cruise),
                np.max(np.abs(jerk) / limits.jerk),
                np.max(np.abs(2 * q - limits.soft_lower - limits.soft_upper) / span),
            ],
        )
        before = (q, qd, qdd)
    # The bounds were reached, so keeping them meant something.
    assert np.all(extremes > 0.95), extremes


@pytest.mark.parametrize("profile", PROFILES)
def test_every_bound_holds_under_random_targets(profile):
    check_random_targets(profile, ticks=4_000 if profile == "normal" else 12_000, seed=0)


@pytest.mark.slow
@pytest.mark.parametrize("profile", PROFILES)
def test_every_bound_holds_for_100_000_ticks(profile):
    check_random_targets(profile, ticks=100_000, seed=1)


def test_a_still_target_is_reached_exactly_and_rest_is_reported():
    limits = Limits.of("normal")
    limiter = RuckigLimiter(limits, DT, q=middle(limits))
    goal = middle(limits) + np.linspace(-0.5, 0.5, 14)

    assert limiter.at_rest
    limiter.tick(goal)
    assert not limiter.at_rest
    for _ in range(300):
        q, qd, qdd = limiter.tick(goal)

    assert limiter.at_rest
    np.testing.assert_allclose(q, goal, rtol=0, atol=1e-9)
    np.testing.assert_allclose(qd, 0.0, atol=1e-9)
    np.testing.assert_allclose(qdd, 0.0, atol=1e-6)


def test_targets_beyond_the_limits_end_at_the_soft_limits():
    limits = Limits.of("normal")
    limiter = RuckigLimiter(limits, DT, q=middle(limits))
    for _ in range(2_000):
        q, _, _ = limiter.tick(np.full(14, 100.0))
    np.testing.assert_allclose(q, limits.soft_upper, rtol=0, atol=1e-7)
    assert np.all(q <= limits.soft_upper)


def ticks_to_stop(limiter: RuckigLimiter) -> int:
    for tick in range(1, 500):
        limiter.stop()
        if limiter.at_rest:
            return tick
    raise AssertionError("never stops")


def test_a_stop_from_full_profile_speed_takes_at_most_100_ms():
    limits = Limits.of("normal")
    limiter = RuckigLimiter(limits, DT, q=limits.soft_lower)
    for _ in range(100):
        _, qd, _ = limiter.tick(limits.soft_upper)
    np.testing.assert_allclose(qd, limits.velocity, rtol=1e-6)

    assert ticks_to_stop(limiter) * DT <= 0.100


def test_a_stop_in_the_midst_of_speeding_up_takes_at_most_100_ms():
    limits = Limits.of("normal")
    worst = 0
    for ticks in range(1, 60):
        limiter = RuckigLimiter(limits, DT, q=limits.soft_lower)
        for _ in range(ticks):
            limiter.tick(limits.soft_upper)
        worst = max(worst, ticks_to_stop(limiter))
    assert worst * DT <= 0.100


def test_motion_goes_on_after_a_stop_only_when_asked():
    limits = Limits.of("normal")
    limiter = RuckigLimiter(limits, DT, q=middle(limits))
    goal = middle(limits) + 0.3
    for _ in range(30):
        limiter.tick(goal)
    ticks_to_stop(limiter)
    stood, _, _ = limiter.stop()
    for _ in range(50):
        q, _, _ = limiter.stop()
    np.testing.assert_allclose(q, stood, rtol=0, atol=1e-12)
    assert limiter.at_rest

    for _ in range(400):
        q, _, _ = limiter.tick(goal)
    np.testing.assert_allclose(q, goal, rtol=0, atol=1e-9)


def test_equal_targets_give_equal_bits():
    limits = Limits.of("normal")
    rng = np.random.default_rng(3)
    targets = rng.uniform(limits.lower, limits.upper, (40, 14)).repeat(10, axis=0)

    def motion() -> np.ndarray:
        limiter = RuckigLimiter(limits, DT, q=middle(limits))
        return np.array([limiter.tick(target) for target in targets])

    np.testing.assert_array_equal(motion(), motion())


@pytest.mark.parametrize(
    ("target", "message"),
    [
        (np.full(14, np.nan), "limiter: target: expected finite angles, got nan at joint 0"),
        (np.full(14, np.inf), "limiter: target: expected finite angles, got inf at joint 0"),
        (np.zeros(13), "limiter: target: expected 14 joints, got shape (13,)"),
        (np.zeros((14, 1)), "limiter: target: expected 14 joints, got shape (14, 1)"),
    ],
)
def test_a_broken_target_is_refused_and_changes_nothing(target, message):
    limits = Limits.of("normal")
    goal = middle(limits) + 0.2
    limiter = RuckigLimiter(limits, DT, q=middle(limits))
    twin = RuckigLimiter(limits, DT, q=middle(limits))
    for _ in range(10):
        limiter.tick(goal)
        twin.tick(goal)

    with pytest.raises(RefusedTarget) as refusal:
        limiter.tick(target)

    assert str(refusal.value) == message
    np.testing.assert_array_equal(limiter.tick(goal), twin.tick(goal))


def test_a_start_outside_the_limits_is_refused():
    limits = Limits.of("normal")
    q = middle(limits)
    q[3] = 3.0
    with pytest.raises(RefusedTarget, match=r"got 3.0000 rad at joint 3; allowed -2.1555 to"):
        RuckigLimiter(limits, DT, q=q)


def test_a_start_between_soft_and_hard_limit_leads_back_inside():
    limits = Limits.of("normal")
    limiter = RuckigLimiter(limits, DT, q=limits.upper)
    for _ in range(200):
        q, qd, _ = limiter.tick(limits.upper)
        assert np.all(qd <= 1e-12)
    np.testing.assert_allclose(q, limits.soft_upper, rtol=0, atol=1e-7)


def test_way_points_never_reach_ruckig():
    # Ruckig's community version sends a problem with way-points to a server.
    tree = ast.parse(Path(module.__file__).read_text())
    names = {node.attr for node in ast.walk(tree) if isinstance(node, ast.Attribute)}
    assert "max_jerk" in names
    assert not {name for name in names if "intermediate" in name or "section" in name}

    limits = Limits.of("normal")
    limiter = RuckigLimiter(limits, DT, q=middle(limits))
    limiter.tick(middle(limits) + 0.1)
    assert limiter._input.intermediate_positions == []
    assert limiter._input.synchronization == module.ruckig.Synchronization.No
    assert limiter._input.target_velocity == [0.0] * 14


def test_soft_limits_lie_two_degrees_inside():
    limits = Limits.of("commissioning")
    np.testing.assert_allclose(np.degrees(limits.soft_lower - limits.lower), 2.0)
    np.testing.assert_allclose(np.degrees(limits.upper - limits.soft_upper), 2.0)


def test_normal_speed_is_half_the_controllers_and_commissioning_a_slow_walk():
    normal, slow = Limits.of("normal"), Limits.of("commissioning")
    np.testing.assert_allclose(np.degrees(normal.velocity[:7]), [90] * 4 + [200] * 3)
    np.testing.assert_array_equal(slow.velocity, 0.2)
    assert np.all(normal.cruise <= normal.acceleration)


def test_an_unknown_profile_is_an_error_that_lists_the_known():
    with pytest.raises(ConfigError, match="expected one of commissioning, normal, got 'fast'"):
        Limits.of("fast")
