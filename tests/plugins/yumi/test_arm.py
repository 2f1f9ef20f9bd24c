"""The model as the stream and the bridge see it: through the protocols and the registry."""

from __future__ import annotations

import numpy as np
import pytest

pytest.importorskip("pinocchio")

from clothrf_yumi.config import YumiConfig
from clothrf_yumi.posture import REST_GRASP

from clothrf_core.errors import ConfigError
from clothrf_core.interfaces import ArmModel
from clothrf_core.provider import BuildContext
from clothrf_core.registry import Registry
from clothrf_core.rig import (
    CameraSection,
    ForegroundSection,
    GraspSection,
    HandsSection,
    Rig,
    TableSection,
)

CORNERS = [[0.45, -0.12, 0.40], [0.45, 0.12, 0.42]]


def rig(corners: list[list[float]]) -> Rig:
    return Rig(
        camera=CameraSection(K=np.eye(3).tolist(), T_world_camera=np.eye(4).tolist()),
        hands=HandsSection(rest=[[0.6, -0.15, 0.3], [0.6, 0.15, 0.3]]),
        grasp=GraspSection(rest=corners),
        table=TableSection(low=[0.0, -0.6, 0.05], high=[1.0, 0.6, 0.10]),
        foreground=ForegroundSection(low=[0.1, -0.4, 0.1], high=[0.9, 0.4, 0.7]),
    )


def build(corners: list[list[float]] | None = None, **options: object) -> ArmModel:
    context = BuildContext(rig=None if corners is None else rig(corners))
    config = YumiConfig.model_validate(options)
    return Registry.installed().build("arm", "yumi", config, context)


def test_ready_holds_the_rest_corners_right_gripper_first():
    arm = build()
    np.testing.assert_allclose(arm.grasp_points(arm.ready), REST_GRASP, rtol=0, atol=1e-6)
    right = np.zeros(14)
    right[7:] = 0.01
    moved = arm.grasp_points(arm.ready + right) - arm.grasp_points(arm.ready)
    assert np.linalg.norm(moved[0]) > 1e-3
    assert np.linalg.norm(moved[1]) == 0.0


def test_ready_of_a_rig_holds_that_rigs_corners():
    arm = build(CORNERS)
    np.testing.assert_allclose(arm.grasp_points(arm.ready), CORNERS, rtol=0, atol=1e-5)


def test_ready_is_the_same_bits_each_time_and_in_each_profile():
    np.testing.assert_array_equal(build().ready, build().ready)
    np.testing.assert_array_equal(build(profile="normal").ready, build().ready)


def test_ready_is_far_from_limits_and_from_collision():
    arm = build()
    margin = np.minimum(arm.ready - arm.limits.soft_lower, arm.limits.soft_upper - arm.ready)
    assert np.degrees(margin.min()) > 25.0
    assert arm.clearance(arm.ready)[0] > 0.06


def test_a_rig_whose_corners_no_arm_reaches_is_a_config_error():
    with pytest.raises(ConfigError, match=r"rig.grasp.rest: expected corners that both arms reach"):
        build([[1.4, -0.15, 0.47], [1.4, 0.15, 0.47]])


def test_the_rigs_table_is_kept_away_from():
    low = build([[0.45, -0.15, 0.20], [0.45, 0.15, 0.20]])
    far = build([[0.45, -0.15, 0.20], [0.45, 0.15, 0.20]], table_height=-0.5)
    distance, pair = low.clearance(low.ready)
    assert pair.endswith("- table")
    assert distance < far.clearance(far.ready)[0]


def test_joints_are_named_left_arm_first_along_the_chain():
    names = build().joint_names
    assert names[:4] == ("yumi_joint_1_l", "yumi_joint_2_l", "yumi_joint_7_l", "yumi_joint_3_l")
    assert names[7] == "yumi_joint_1_r"
    assert len(set(names)) == 14


def test_grasp_speeds_are_the_derivative_of_grasp_points():
    arm, rng = build(), np.random.default_rng(0)
    for _ in range(10):
        q, qd = arm.ready + rng.normal(0.0, 0.2, 14), rng.normal(0.0, 1.0, 14)
        h = 1e-6
        numeric = (arm.grasp_points(q + h * qd) - arm.grasp_points(q - h * qd)) / (2 * h)
        np.testing.assert_allclose(
            arm.grasp_speeds(q, qd), np.linalg.norm(numeric, axis=1), rtol=1e-6
        )


def test_a_limiter_starts_at_rest_where_it_is_told():
    arm = build(profile="normal")
    limiter = arm.limiter(0.004, q=arm.ready)
    assert limiter.at_rest
    np.testing.assert_array_equal(limiter.stop()[0], arm.ready)


def test_callers_cannot_change_the_model():
    arm = build()
    ready = arm.ready
    ready[:] = 0.0
    np.testing.assert_allclose(arm.grasp_points(arm.ready), REST_GRASP, rtol=0, atol=1e-6)
    with pytest.raises(ValueError, match="read-only"):
        arm.limits.velocity[0] = 9.0


def test_capsules_move_with_the_arms():
    arm = build()
    before, after = arm.capsules(arm.ready), arm.capsules(arm.ready + 0.1)
    assert len(before) == 18
    assert all(radius > 0.02 for _, _, radius in before)
    assert np.linalg.norm(before[8][0] - after[8][0]) > 0.01


def test_commissioning_is_the_default():
    assert build().limits.velocity.max() == 0.2
