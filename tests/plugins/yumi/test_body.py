"""Distances and their derivatives against brute force and finite differences."""

from __future__ import annotations

import numpy as np
import pytest

pytest.importorskip("pinocchio")

from clothrf_yumi.body import Body
from clothrf_yumi.irb14000 import FINGER_TCP_M
from clothrf_yumi.kinematics import Kinematics
from clothrf_yumi.limits import Limits
from clothrf_yumi.posture import seed

LIMITS = Limits.of("normal")


def body_at(q: np.ndarray, *, table_height: float = -0.02, padding: float = 0.0) -> Body:
    """A body without any memory of other postures."""
    kinematics = Kinematics(FINGER_TCP_M)
    body = Body(kinematics, table_height=table_height, padding=padding)
    kinematics.update(q)
    return body


def test_derivatives_are_right_apart_and_in_penetration():
    rng = np.random.default_rng(0)
    kinematics = Kinematics(FINGER_TCP_M)
    body = Body(kinematics, table_height=-0.02, padding=0.01)
    apart, inside, h = 0, 0, 1e-6
    for _ in range(60):
        q = rng.uniform(LIMITS.lower, LIMITS.upper)
        kinematics.update(q)
        near = body.near(0.05)
        if not near.distance.size:
            continue
        k = int(np.argmin(near.distance))
        numeric = np.zeros(14)
        for j, step in enumerate(h * np.eye(14)):
            kinematics.update(q + step)
            ahead, pair = body.clearance()
            kinematics.update(q - step)
            behind, other = body.clearance()
            assert pair == other
            numeric[j] = (ahead - behind) / (2 * h)
        np.testing.assert_allclose(near.rows[k], numeric, rtol=0, atol=2e-4)
        apart += near.distance[k] > 0
        inside += near.distance[k] < 0
    assert apart >= 5
    assert inside >= 5


def test_remembered_bounds_never_change_an_answer():
    rng = np.random.default_rng(1)
    kinematics = Kinematics(FINGER_TCP_M)
    body = Body(kinematics, table_height=-0.02, padding=0.01)
    q, target = seed(), seed()
    for step in range(300):
        if step % 60 == 0:
            target = rng.uniform(LIMITS.lower, LIMITS.upper)
        q = q + np.clip(target - q, -0.04, 0.04)
        kinematics.update(q)
        near, closer = body.near(0.05), body.closer(0.015)
        clearance = body.clearance()
        if step % 10 == 0:
            fresh = body_at(q, padding=0.01)
            distance, pair = fresh.clearance()
            assert clearance == (pytest.approx(distance, abs=1e-12), pair)
            assert closer == fresh.closer(0.015)
            truth = fresh.near(0.05)
            np.testing.assert_allclose(near.distance, truth.distance, rtol=0, atol=1e-12)
            np.testing.assert_allclose(near.rows, truth.rows, rtol=0, atol=1e-12)


def test_the_distance_of_two_capsules_is_that_of_their_segments():
    q = seed()
    body = body_at(q)
    distance, pair = body.clearance()
    one, other = (body._names.index(name) for name in pair.split(" - "))
    assert max(one, other) < 18, "both are capsules"

    share = np.linspace(0.0, 1.0, 400)[:, None]
    capsules = body.capsules()
    lines = [p0 + share * (p1 - p0) for p0, p1, _ in (capsules[one], capsules[other])]
    gaps = np.linalg.norm(lines[0][:, None] - lines[1][None], axis=2)

    assert distance == pytest.approx(gaps.min() - capsules[one][2] - capsules[other][2], abs=2e-5)


def lowest() -> float:
    """Lowest point of the arms at rest but their two first links, which stay at the shoulder."""
    capsules = body_at(seed()).capsules()
    moving = [capsule for i, capsule in enumerate(capsules) if i % 9 >= 2]
    return min(float(p[2]) - r for p0, p1, r in moving for p in (p0, p1))


def test_the_table_is_where_the_config_says():
    # The arms at rest are far above any table; raise it until it is the nearest thing.
    distance, pair = body_at(seed(), table_height=lowest() - 0.03).clearance()

    assert pair.endswith("- table")
    assert distance == pytest.approx(0.03, abs=1e-9)


def test_padding_counts_for_body_and_table_only():
    height = lowest() - 0.04

    plain = body_at(seed(), table_height=height).clearance()[0]
    padded = body_at(seed(), table_height=height, padding=0.01).clearance()[0]

    assert plain - padded == pytest.approx(0.01, abs=1e-9)
    between_arms = body_at(seed(), padding=0.03).clearance()
    assert between_arms == body_at(seed()).clearance()


def test_neighbours_in_the_chain_are_no_pair_and_both_arms_meet_everywhere():
    pairs = {frozenset(pair) for pair in body_at(seed()).pairs}

    assert frozenset(("left link 1", "left link 2")) not in pairs
    assert frozenset(("left link 5", "left gripper")) not in pairs
    assert frozenset(("left fingers", "right fingers")) in pairs
    assert frozenset(("left link 2", "left fingers")) in pairs
    assert frozenset(("right gripper", "table")) in pairs
    assert len(pairs) == 80 + 2 * 7 * 5 + 2 * 11


def test_arms_folded_into_each_other_are_in_penetration():
    left = np.radians([0, -60, 0, 60, 0, 40, 0])  # both arms reach for the middle
    inwards = np.radians([-75, -90, 45, 0, 30, 90, 10])
    mirror = np.array([-1, 1, -1, 1, -1, 1, -1])
    assert body_at(np.concatenate([left, left * mirror])).clearance()[0] > -0.2
    distance, pair = body_at(np.concatenate([-inwards * mirror, -inwards])).clearance()
    assert distance < 0.0, pair


def test_a_capsule_is_drawn_around_every_gripper():
    body = body_at(seed())
    points = Kinematics(FINGER_TCP_M).grasp_points(seed())
    capsules = body.capsules()
    assert len(capsules) == 18
    for i, fingers in ((1, capsules[8]), (0, capsules[17])):
        p0, p1, radius = fingers
        middle = (p0 + p1) / 2.0
        assert np.linalg.norm(middle - points[i]) < radius
