from __future__ import annotations

import dataclasses
import json
from pathlib import Path
from typing import Any

import cv2
import numpy as np
import pytest
from clothrf_calibration import rigid, synthetic
from clothrf_calibration.boardpose import fit_pose
from clothrf_calibration.boards import Board, half_turn
from clothrf_calibration.errors import CalibrationError, DegenerateData
from clothrf_calibration.handeye import HandEye, best_start, hand_eye
from clothrf_calibration.handeye_fit import HandEyeProblem, Setup
from clothrf_calibration.handeye_poses import fit_poses, held_out_poses
from clothrf_calibration.handeye_start import methods, park, shah
from clothrf_calibration.lens import vector
from clothrf_calibration.motion import motion, unflipped
from clothrf_calibration.robotnoise import refine_with_noise
from scipy.spatial.transform import Rotation
from scipy.stats import chi2

from clothrf_core.types import Float

BOARD = Board(kind="charuco", columns=10, rows=7, square=0.02)
SMALL = Board(kind="charuco", columns=7, rows=5, square=0.03)
MODEL = synthetic.camera()
INTRINSICS = vector(MODEL.K, MODEL.distortion)


def rig(
    seed: int, count: int = 20, *, board: Board = BOARD, **options: Any
) -> synthetic.HandEyeRig:
    return synthetic.hand_eye_rig(np.random.default_rng(seed), board, MODEL, count, **options)


def solved(r: synthetic.HandEyeRig, **options: Any) -> HandEye:
    setup: Setup = "fixed" if r.setup == "fixed" else "hand"
    return hand_eye(r.views, r.T_base_gripper, BOARD, INTRINSICS, setup=setup, **options)


def error(X: Float, truth: Float) -> tuple[float, float]:
    return (
        1e3 * float(np.linalg.norm(X[:3, 3] - truth[:3, 3])),
        float(rigid.angle_deg(X[:3, :3] @ truth[:3, :3].T)),
    )


def problem_of(r: synthetic.HandEyeRig, board: Board = BOARD) -> tuple[HandEyeProblem, Float]:
    keep = [i for i, v in enumerate(r.views) if len(v.ids) >= 8]
    views = [r.views[i] for i in keep]
    G = r.T_base_gripper[keep]
    A = G if r.setup == "fixed" else rigid.inverse(G)
    C = np.stack([fit_pose(INTRINSICS, board.points, v)[0] for v in views])
    setup: Setup = "fixed" if r.setup == "fixed" else "hand"
    return HandEyeProblem(setup, A, views, board.points, 0.2, INTRINSICS), C


# Real poses.


@pytest.fixture(scope="module")
def pairs(data: Path) -> tuple[Float, Float]:
    values = np.array(json.loads((data / "moveit_handeye" / "pose_samples.json").read_text()))
    return values[:, 0], values[:, 1]


def test_real_poses_give_the_published_camera(pairs: tuple[Float, Float], expected: Any) -> None:
    want = expected["moveit_handeye"]

    X = fit_poses(*pairs).X

    t, euler = want["published_camera_in_base_t_m"], want["published_euler_XYZ_rad"]
    assert np.linalg.norm(X[:3, 3] - t) < 0.01 * np.linalg.norm(t)
    published = Rotation.from_euler("XYZ", euler).as_matrix()
    # The published angles have three digits: 1 % of their norm.
    assert np.radians(error(X, np.block([[published, np.zeros((3, 1))], [0, 0, 0, 1]]))[1]) < (
        0.01 * np.linalg.norm(euler)
    )


def test_real_poses_scatter_no_more_than_the_reference(
    pairs: tuple[Float, Float], expected: Any
) -> None:
    shift, turn = held_out_poses(*pairs)

    # The reference has three digits.
    assert (
        round(np.sqrt((shift**2).mean()), 2)
        <= expected["moveit_handeye"]["held_out_5fold_scatter_mm"]
    )
    assert (
        round(np.sqrt((turn**2).mean()), 3)
        <= expected["moveit_handeye"]["held_out_5fold_scatter_deg"]
    )


def test_outliers_among_real_poses_hurt_opencv_but_not_us(pairs: tuple[Float, Float]) -> None:
    A, C = (np.array(p) for p in pairs)
    truth = fit_poses(A, C).X
    rng = np.random.default_rng(0)
    for n in rng.choice(50, 5, replace=False):
        A[n, :3, 3] += rng.uniform(-0.1, 0.1, 3)
        A[n, :3, :3] = rigid.exp(rng.uniform(-0.1, 0.1, 3)) @ A[n, :3, :3]

    ours = error(fit_poses(A, C).X, truth)
    theirs = {
        name: error(solver(A, C)[0], truth)
        for name, solver in methods().items()
        if name.startswith("cv2")
    }

    assert ours[0] < 2.0
    assert ours[1] < 0.1
    assert all(ours[0] < mm for mm, _ in theirs.values())


# Known truth.


@pytest.mark.parametrize("setup", ["fixed", "hand"])
def test_closed_forms_are_exact_without_noise(setup: str) -> None:
    r = rig(0, setup=setup, noise=0.0)
    problem, C = problem_of(r)

    for name, solver in methods().items():
        X, Z = solver(problem.A, C)
        assert error(X, r.X)[0] < 1e-3, name
        assert error(Z, r.Z)[0] < 1e-3, name


def test_park_is_opencvs() -> None:
    problem, C = problem_of(rig(1))
    G = rigid.inverse(problem.A)

    R, t = cv2.calibrateHandEye(
        R_gripper2base=list(G[:, :3, :3]), t_gripper2base=list(G[:, :3, 3]),
        R_target2cam=list(C[:, :3, :3]), t_target2cam=list(C[:, :3, 3]),
        method=cv2.CALIB_HAND_EYE_PARK,
    )  # fmt: skip

    X, _ = park(problem.A, C)
    # Ours solves the rotation by SVD of all pairs, which is Park's solution for small noise.
    assert np.degrees(np.abs(X[:3, :3] - R).max()) < 0.05
    assert np.abs(X[:3, 3] - np.ravel(t)).max() < 1e-3


def test_shah_is_opencvs() -> None:
    problem, C = problem_of(rig(2))
    A = problem.A

    R_bw, t_bw, R_gc, t_gc = cv2.calibrateRobotWorldHandEye(
        R_world2cam=list(C[:, :3, :3]), t_world2cam=list(C[:, :3, 3]),
        R_base2gripper=list(A[:, :3, :3]), t_base2gripper=list(A[:, :3, 3]),
        method=cv2.CALIB_ROBOT_WORLD_HAND_EYE_SHAH,
    )  # fmt: skip

    # OpenCV's equation is C X' = Z' A with X' = inv(Z) of ours, Z' = inv(X) of ours.
    X, Z = shah(A, C)
    assert np.allclose(rigid.inverse(Z)[:3, :3], R_bw, atol=1e-8)
    assert np.allclose(rigid.inverse(X)[:3, :3], R_gc, atol=1e-8)
    assert np.abs(rigid.inverse(X)[:3, 3] - np.ravel(t_gc)).max() < 1e-4
    assert np.abs(rigid.inverse(Z)[:3, 3] - np.ravel(t_bw)).max() < 1e-4


@pytest.mark.parametrize("setup", ["fixed", "hand"])
def test_twenty_views_with_a_fifth_of_a_pixel_of_noise_give_a_tenth_of_a_millimetre(
    setup: str,
) -> None:
    errors = np.array([error(solved(r).X, r.X) for r in (rig(s, setup=setup) for s in range(3))])

    assert np.median(errors[:, 0]) < 0.2
    assert np.median(errors[:, 1]) < 0.02


@pytest.mark.parametrize(("mm", "deg"), [(0.0, 0.0), (0.5, 0.1)])
@pytest.mark.slow
@pytest.mark.timeout(600)
def test_the_stated_uncertainty_of_the_pose_is_right(mm: float, deg: float) -> None:
    inside, errors = 0, []

    for seed in range(100):
        setup = ("fixed", "hand")[seed % 2]
        r = rig(seed, 12, board=SMALL, setup=setup, robot_mm=mm, robot_deg=deg)
        problem, C = problem_of(r, SMALL)
        _, (X, Z), _ = best_start(problem, C)
        result, _ = refine_with_noise(problem, X, Z)
        d = result.pose @ rigid.inverse(r.X)
        x = np.concatenate([rigid.log(d[:3, :3]), result.pose[:3, 3] - r.X[:3, 3]])
        inside += int(x @ np.linalg.solve(result.pose_covariance, x) < chi2.ppf(0.95, 6))
        errors.append(error(result.pose, r.X))

    assert 90 <= inside <= 99
    if mm == 0.0:
        median = np.median(errors, axis=0)
        assert median[0] <= 0.5
        assert median[1] <= 0.05


def test_the_robots_inexactness_is_found_out() -> None:
    found = [solved(rig(s, 25, robot_mm=0.5, robot_deg=0.1)).noise for s in range(3)]

    assert np.median([n.shift for n in found]) * np.sqrt(3) == pytest.approx(5e-4, rel=0.35)
    assert np.degrees(np.median([n.turn for n in found])) * np.sqrt(3) == pytest.approx(
        0.1, rel=0.35
    )


def test_a_perfect_robot_is_called_perfect() -> None:
    assert not solved(rig(3)).noise.any


def test_wrong_corners_and_wrong_poses_hurt_opencv_but_not_us() -> None:
    r = rig(5, 24, robot_mm=0.1, robot_deg=0.02)
    rng = np.random.default_rng(5)
    views = []
    for v in r.views:
        pixels = np.array(v.pixels)
        wrong = rng.random(len(pixels)) < 0.05
        pixels[wrong] += rng.uniform(-20, 20, (int(wrong.sum()), 2))
        views.append(dataclasses.replace(v, pixels=pixels))
    G = np.array(r.T_base_gripper)
    G[4, :3, 3] += [0.03, 0.0, 0.0]
    G[11, :3, :3] = rigid.exp(np.array([0.0, 0.1, 0.0])) @ G[11, :3, :3]

    result = hand_eye(views, G, BOARD, INTRINSICS)
    keep = [i for i, v in enumerate(views) if len(v.ids) >= 8]
    C = np.stack([fit_pose(INTRINSICS, BOARD.points, views[i])[0] for i in keep])
    plain = min(error(s(G[keep], C)[0], r.X)[0] for n, s in methods().items() if "cv2" in n)

    assert set(result.dropped) >= {r.views[4].name, r.views[11].name}
    assert error(result.X, r.X)[0] < 0.5 < plain


def test_held_out_views_are_predicted_better_than_by_opencv() -> None:
    r = rig(6, 20, robot_mm=0.2, robot_deg=0.05)
    problem, C = problem_of(r)
    _, _, errors = best_start(problem, C)

    result = solved(r)

    assert np.sqrt((result.held_out_px**2).mean()) < min(
        e for name, e in errors.items() if name.startswith("cv2")
    )


def test_a_wrong_square_size_is_measured_by_the_robot() -> None:
    r = rig(7)
    drawn = BOARD.model_copy(update={"square": 0.0205})

    result = hand_eye(r.views, r.T_base_gripper, drawn, INTRINSICS)

    assert result.scale[0] == pytest.approx(0.02 / 0.0205, abs=2e-3)
    assert any(
        w.startswith(("the robot measures squares of 20.0", "the robot measures squares of 19.9"))
        for w in result.warnings
    )


def test_uncertain_intrinsics_widen_the_uncertainty_of_the_pose() -> None:
    r = rig(8)
    covariance = np.diag([4.0, 4.0, 4.0, 4.0, 1e-4, 1e-4, 1e-8, 1e-8])

    exact, loose = solved(r), solved(r, covariance=covariance)

    assert loose.sd_mm > 1.5 * exact.sd_mm


def test_a_symmetric_board_read_upside_down_is_put_right() -> None:
    board = Board(kind="circles", columns=9, rows=6, square=0.02)
    rng = np.random.default_rng(9)
    r = synthetic.hand_eye_rig(rng, board, MODEL, 20)
    views = [
        dataclasses.replace(v, ids=53 - v.ids) if n in (2, 7, 11) else v
        for n, v in enumerate(r.views)
    ]

    result = hand_eye(views, r.T_base_gripper, board, INTRINSICS)

    assert result.turned == ("view002", "view007", "view011")
    assert error(result.X, r.X)[0] < 0.5


def test_flips_are_found_from_angles_alone() -> None:
    board = Board(kind="circles", columns=9, rows=6, square=0.02)
    r = synthetic.hand_eye_rig(np.random.default_rng(4), board, MODEL, 12, noise=0.0)
    C = rigid.inverse(r.X) @ r.T_base_gripper @ r.Z
    seen = np.array(C)
    seen[[1, 5]] = C[[1, 5]] @ half_turn(board)

    fixed, flips = unflipped(r.T_base_gripper, seen, board)

    assert np.nonzero(flips)[0].tolist() == [1, 5]
    assert np.allclose(fixed, C)


# Bad input.


def test_pictures_and_poses_of_different_number_are_refused() -> None:
    r = rig(0)

    with pytest.raises(CalibrationError) as caught:
        hand_eye(r.views, r.T_base_gripper[:-1], BOARD, INTRINSICS)

    assert str(caught.value) == (
        "expected a pose for every picture, found 20 pictures and 19 poses; give every pose the "
        "name of its picture"
    )


def test_poses_in_the_wrong_order_are_refused() -> None:
    r = rig(0)

    with pytest.raises(CalibrationError, match="poses and pictures do not belong together"):
        hand_eye(r.views, np.roll(r.T_base_gripper, 1, axis=0), BOARD, INTRINSICS)


@pytest.mark.parametrize(("true", "told"), [("fixed", "hand"), ("hand", "fixed")])
def test_the_wrong_setup_is_recognised(true: str, told: Setup) -> None:
    r = rig(1, setup=true)

    with pytest.raises(CalibrationError, match=f"pass --setup {true}"):
        hand_eye(r.views, r.T_base_gripper, BOARD, INTRINSICS, setup=told)


def test_turning_about_one_axis_only_is_refused() -> None:
    r = rig(2, noise=0.0)
    angles = np.linspace(-0.6, 0.6, 12)
    C = np.tile(np.eye(4), (12, 1, 1))
    C[:, :3, :3] = rigid.exp(np.stack([0 * angles, 0 * angles, angles], axis=1))
    C[:, :3, 3] = [-0.09, -0.06, 0.5]
    G = r.X @ C @ rigid.inverse(r.Z)
    views = synthetic.views(np.random.default_rng(0), BOARD, MODEL, C, noise=0.05)

    with pytest.raises(DegenerateData, match="degenerate motion: the gripper turned by"):
        hand_eye(views, G, BOARD, INTRINSICS)


def test_weak_motion_is_warned_of() -> None:
    result = solved(rig(3, tilt=0.25))

    assert any("about a second axis" in w for w in result.warnings)


def test_consistency_of_angles_does_not_depend_on_the_camera() -> None:
    r = rig(4, noise=0.0)
    C = rigid.inverse(r.X) @ r.T_base_gripper @ r.Z

    assert motion(r.T_base_gripper, C).median < 1e-9
