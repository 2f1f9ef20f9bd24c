"""Forward kinematics and Jacobians against poses of a real controller and finite differences."""

from __future__ import annotations

import json
from pathlib import Path

import numpy as np
import pytest

pin = pytest.importorskip("pinocchio")

from clothrf_yumi.irb14000 import FINGER_TCP_M  # noqa: E402
from clothrf_yumi.kinematics import Kinematics  # noqa: E402
from clothrf_yumi.limits import Limits  # noqa: E402
from clothrf_yumi.urdf import urdf  # noqa: E402

REFERENCE = Path(__file__).parents[2] / "data" / "yumi" / "fk_reference.json"
POSES = json.loads(REFERENCE.read_text())["poses"]
MIRROR = np.array([-1.0, 1.0, -1.0, 1.0, -1.0, 1.0, -1.0])


@pytest.fixture(scope="module")
def kinematics() -> Kinematics:
    return Kinematics(FINGER_TCP_M)


def joints(pose: dict) -> np.ndarray:
    arms = [pose[side]["joints_deg_chain_1_2_7_3_4_5_6"] for side in ("left", "right")]
    return np.radians(np.concatenate(arms))


@pytest.mark.parametrize("pose", POSES, ids=[pose["name"] for pose in POSES])
def test_gripper_poses_equal_the_reference(pose, kinematics):
    q = joints(pose)

    points = kinematics.grasp_points(q)
    rotations = kinematics.rotations()

    for i, side in enumerate(("right", "left")):
        truth = pose[side]["tcp_fingers"]
        w, x, y, z = truth["q_wxyz"]
        np.testing.assert_allclose(points[i], truth["p"], rtol=0, atol=1e-9)
        wanted = pin.Quaternion(w, x, y, z).matrix()
        np.testing.assert_allclose(rotations[i], wanted, rtol=0, atol=1e-9)


def test_the_controllers_home_target_is_met():
    # The jointtarget [[0,-130,30,0,40,0],[135]] and its robtarget for tool0, from ABB's programs.
    flange = Kinematics(1e-12)
    left = np.radians([0, -130, 135, 30, 0, 40, 0])

    points = flange.grasp_points(np.concatenate([left, left * MIRROR]))

    home = np.array([-9.578368507, 182.609892723, 198.627808149]) / 1000.0
    np.testing.assert_allclose(points, [home * [1, -1, 1], home], rtol=0, atol=1e-9)


def test_the_arms_mirror_each_other(kinematics):
    rng = np.random.default_rng(0)
    limits = Limits.of("normal")
    for _ in range(50):
        left = rng.uniform(limits.lower[:7], limits.upper[:7])
        right, other = kinematics.grasp_points(np.concatenate([left, left * MIRROR]))
        np.testing.assert_allclose(right, other * [1, -1, 1], rtol=0, atol=1e-12)


def test_the_jacobian_is_the_derivative_of_points_and_rotations(kinematics):
    rng = np.random.default_rng(1)
    limits = Limits.of("normal")
    h = 1e-6
    for _ in range(20):
        q = rng.uniform(limits.lower, limits.upper)
        kinematics.update(q)
        J = kinematics.grasp_jacobian()
        numeric = np.zeros((12, 14))
        for j, step in enumerate(h * np.eye(14)):
            ahead = kinematics.grasp_points(q + step)
            R_ahead = [R.copy() for R in kinematics.rotations()]
            behind = kinematics.grasp_points(q - step)
            R_behind = [R.copy() for R in kinematics.rotations()]
            numeric[:6, j] = (ahead - behind).ravel() / (2 * h)
            turns = [pin.log3(a @ b.T) for a, b in zip(R_ahead, R_behind, strict=True)]
            numeric[6:, j] = np.concatenate(turns) / (2 * h)
        np.testing.assert_allclose(J, numeric, rtol=0, atol=1e-7)


def test_the_shipped_urdf_is_what_the_numbers_give():
    import clothrf_yumi

    shipped = Path(clothrf_yumi.__file__).with_name("yumi.urdf").read_text(encoding="utf-8")
    assert shipped == urdf()


def test_an_arm_weighs_what_two_arms_leave_of_the_whole_robot(kinematics):
    # 38 kg by the datasheet, 24.18 kg of it the base; the grippers are ours.
    arms = sum(inertia.mass for inertia in kinematics.model.inertias[1:])
    assert arms == pytest.approx(38.0 - 24.18 + 2 * 0.230, abs=0.2)


def test_joint_limits_of_the_urdf_are_those_of_the_limits(kinematics):
    limits = Limits.of("normal")
    np.testing.assert_array_equal(kinematics.model.lowerPositionLimit, limits.lower)
    np.testing.assert_array_equal(kinematics.model.upperPositionLimit, limits.upper)
    np.testing.assert_allclose(kinematics.model.velocityLimit, 2 * limits.velocity, rtol=1e-12)
