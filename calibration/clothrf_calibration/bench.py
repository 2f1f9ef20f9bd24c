"""Accuracy, honesty and speed of the solvers on rigs whose truth is known."""

from __future__ import annotations

import time

import numpy as np

from clothrf_calibration import rigid, synthetic
from clothrf_calibration.boarddrawing import drawing
from clothrf_calibration.boardpose import fit_pose
from clothrf_calibration.boardprint import board_picture
from clothrf_calibration.boards import Board
from clothrf_calibration.detect import detect
from clothrf_calibration.handeye import best_start
from clothrf_calibration.handeye_fit import HandEyeProblem
from clothrf_calibration.intrinsics import calibrate
from clothrf_calibration.intrinsics_fit import fit
from clothrf_calibration.lens import vector
from clothrf_calibration.robotnoise import refine_with_noise
from clothrf_calibration.threads import one_thread
from clothrf_core.provider import Figure
from clothrf_core.types import Float

CHESSBOARD = Board(kind="chessboard", columns=9, rows=6, square=0.025)
CHARUCO = Board(kind="charuco", columns=10, rows=7, square=0.02)
# 95 % of a chi-squared variable of 8 and of 6 degrees of freedom.
CHI2_8, CHI2_6 = 15.507, 12.592


def intrinsics(*, quick: bool) -> list[Figure]:
    """How often the truth lies in the stated 95 % region, and how far off the focal length is."""
    model = synthetic.camera()
    truth = vector(model.K, model.distortion)
    inside, focal = [], []
    with one_thread():
        for seed in range(20 if quick else 100):
            rng = np.random.default_rng(seed)
            poses = synthetic.board_poses(rng, CHESSBOARD, 20)
            views = [v for v in synthetic.views(rng, CHESSBOARD, model, poses) if len(v.ids) >= 20]
            result = fit(views, CHESSBOARD, model=4, shape="warp")
            error = result.state.parameters - truth
            C = result.covariance[:8, :8]
            inside.append(float(error @ np.linalg.solve(C, error)) < CHI2_8)
            focal.append(abs(float(error[0])) / truth[0])
    return [
        Figure("calibration_intrinsics_coverage", float(np.mean(inside)), "share",
               {"seeds": len(inside), "wanted": "0.90 to 0.99"}),
        Figure("calibration_focal_error", float(np.median(focal)), "1",
               {"p95": float(np.percentile(focal, 95))}),
    ]  # fmt: skip


def hand_eye(*, quick: bool) -> list[Figure]:
    """Pose error at 0.2 px and 20 views, coverage of the stated region, OpenCV beside it."""
    figures = []
    for setup in ("fixed", "hand"):
        for mm, deg in ((0.0, 0.0), (0.5, 0.1)):
            errors, inside, theirs = _hand_eye_runs(setup, mm, deg, 10 if quick else 100)
            name = f"calibration_{setup}" + ("" if mm == 0 else "_robot_0.5mm_0.1deg")
            detail = {"p95": float(np.percentile(errors[:, 0], 95)), "seeds": len(errors)}
            detail["best cv2 closed form"] = float(np.median(theirs))
            figures += [
                Figure(f"{name}_mm", float(np.median(errors[:, 0])), "mm", detail),
                Figure(f"{name}_deg", float(np.median(errors[:, 1])), "deg"),
                Figure(f"{name}_coverage", float(np.mean(inside)), "share"),
            ]
    return figures


def _hand_eye_runs(
    setup: str, mm: float, deg: float, seeds: int
) -> tuple[Float, list[bool], list[float]]:
    model = synthetic.camera()
    parameters = vector(model.K, model.distortion)
    errors, inside, theirs = [], [], []
    with one_thread():
        for seed in range(seeds):
            rig = synthetic.hand_eye_rig(
                np.random.default_rng(seed), CHARUCO, model, 20, setup=setup, robot_mm=mm,
                robot_deg=deg,
            )  # fmt: skip
            keep = [i for i, v in enumerate(rig.views) if len(v.ids) >= 8]
            views = [rig.views[i] for i in keep]
            G = rig.T_base_gripper[keep]
            C = np.stack([fit_pose(parameters, CHARUCO.points, v)[0] for v in views])
            problem = HandEyeProblem(
                "fixed" if setup == "fixed" else "hand",
                G if setup == "fixed" else rigid.inverse(G),
                views, CHARUCO.points, 0.2, parameters,
            )  # fmt: skip
            _, (X, Z), _ = best_start(problem, C)
            theirs.append(1e3 * float(np.linalg.norm(X[:3, 3] - rig.X[:3, 3])))
            result, _ = refine_with_noise(problem, X, Z)
            off = result.pose @ rigid.inverse(rig.X)
            shift = result.pose[:3, 3] - rig.X[:3, 3]
            turn = rigid.log(off[:3, :3])
            x = np.concatenate([turn, shift])
            inside.append(float(x @ np.linalg.solve(result.pose_covariance, x)) < CHI2_6)
            errors.append(
                (1e3 * float(np.linalg.norm(shift)), float(np.degrees(np.linalg.norm(turn))))
            )
    return np.array(errors), inside, theirs


def speed(*, quick: bool) -> list[Figure]:
    """CPU seconds of 50 pictures at 1920 x 1440: finding the board, and solving for everything."""
    model = synthetic.enlarged(synthetic.camera(), 3.0)
    rng = np.random.default_rng(0)
    sheet, scale, _ = board_picture(CHESSBOARD, 1100)
    page = np.full((model.height, model.width), 200, np.uint8)
    page[100 : 100 + sheet.shape[0], 200 : 200 + sheet.shape[1]] = sheet
    start = time.process_time()
    count = 2 if quick else 10
    for _ in range(count):
        detect(CHESSBOARD, page)
    per_picture = (time.process_time() - start) / count
    views = [
        v
        for v in synthetic.views(rng, CHESSBOARD, model, synthetic.board_poses(rng, CHESSBOARD, 70))
        if len(v.ids) >= 20
    ][:50]
    start = time.process_time()
    calibrate(views, CHESSBOARD)
    solving = time.process_time() - start
    squares = len(drawing(CHESSBOARD).rectangles)
    detail = {"finding": 50 * per_picture, "solving": solving, "views": len(views),
              "squares": squares, "pixels a metre": scale}  # fmt: skip
    return [
        Figure("calibration_50_pictures_cpu_s", 50 * per_picture + solving, "s", detail),
    ]
