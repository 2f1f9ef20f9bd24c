from __future__ import annotations

import dataclasses
from typing import Any

import cv2
import numpy as np
import pytest
from clothrf_calibration import rigid, synthetic
from clothrf_calibration.boards import Board
from clothrf_calibration.crossvalidation import view_error
from clothrf_calibration.errors import CalibrationError, DegenerateData
from clothrf_calibration.intrinsics import Calibration, Options, calibrate, correlation
from clothrf_calibration.intrinsics_fit import fit, real_points
from clothrf_calibration.lens import directions, project, project_jacobian, vector
from clothrf_calibration.views import View
from scipy.optimize import least_squares
from scipy.stats import chi2

from clothrf_core.types import Float

BOARD = Board(kind="chessboard", columns=9, rows=6, square=0.025)


@pytest.fixture(scope="module")
def left(left_views: list[View], left_board: Board) -> Calibration:
    return calibrate(left_views, left_board)


def made(seed: int, count: int = 20, *, noise: float = 0.2, **options: Any) -> list[View]:
    rng = np.random.default_rng(seed)
    poses = synthetic.board_poses(rng, BOARD, count, **options)
    views = synthetic.views(rng, BOARD, synthetic.camera(), poses, noise=noise)
    return [v for v in views if len(v.ids) >= 20]


def plain_cv2(views: list[View], board: Board) -> Float:
    """What `cv2.calibrateCamera` says with its defaults (five coefficients, all corners)."""
    _, K, distortion, _, _ = cv2.calibrateCamera(
        objectPoints=[board.points[v.ids].astype(np.float32) for v in views],
        imagePoints=[v.pixels.astype(np.float32) for v in views],
        imageSize=views[0].size,
        cameraMatrix=None,
        distCoeffs=None,
    )
    return vector(np.asarray(K, float), np.ravel(distortion).astype(float))


def held_out(parameters: Float, points: Float, views: list[View]) -> float:
    return float(np.sqrt(np.mean([view_error(parameters, points, v) ** 2 for v in views])))


# Real pictures.


def test_real_pictures_give_the_reference_focal_length_and_centre(
    left: Calibration, expected: Any
) -> None:
    mrcal = expected["opencv_left"]["mrcal_2.2_OPENCV5_win5"]
    opencv = expected["opencv_left"]["cv2_4.14_adaptive_window"]

    for n, name in enumerate(("fx", "fy", "cx", "cy")):
        low, high = sorted((mrcal[name], opencv[name]))
        assert low - 1.0 < left.parameters[n] < high + 1.0


def test_real_pictures_reach_the_reference_residual(left: Calibration, expected: Any) -> None:
    mrcal = expected["opencv_left"]["mrcal_2.2_OPENCV5_win5"]["rms_per_axis_px"] * np.sqrt(2)
    opencv = expected["opencv_left"]["cv2_4.14_adaptive_window"]["rms_px"]

    assert left.fit.rms < min(mrcal, opencv)
    assert left.fit.rejected == 0


def test_real_pictures_give_the_reference_board_warp(
    left_views: list[View], left_board: Board, expected: Any
) -> None:
    reference = expected["opencv_left"]["mrcal_2.2_OPENCV5_win5"]["board_warp_m"]

    result = fit(left_views, left_board, model=5, shape="warp")

    assert np.allclose(result.state.shape, reference, atol=3e-5)


def test_the_uncertainty_of_the_reference_model_is_like_the_references(
    left_views: list[View], left_board: Board, expected: Any
) -> None:
    reference = expected["opencv_left"]["mrcal_2.2_OPENCV5_win5"]["proj_uncertainty_infinity_px"]

    result = calibrate(left_views, left_board, Options(model=5, shape="warp"))

    assert 0.5 < result.uncertainty.mean / reference["mean"] < 2.0
    assert 0.5 < result.uncertainty.worst / reference["worst_corner"] < 3.5


def test_empty_cells_of_the_real_pictures_are_said(left: Calibration) -> None:
    assert any(w.startswith("14 of 48 cells of the picture hold no corner") for w in left.warnings)


@pytest.mark.parametrize("seed", range(4))
def test_outliers_in_real_pictures_cost_plain_cv2_its_held_out_error_but_not_ours(
    left_views: list[View], left_board: Board, seed: int
) -> None:
    rng = np.random.default_rng(seed)
    order = rng.permutation(len(left_views))
    train, test = [left_views[i] for i in order[:9]], [left_views[i] for i in order[9:]]
    spoiled = []
    for view in train:
        pixels = np.array(view.pixels)
        wrong = rng.random(len(pixels)) < 0.03
        pixels[wrong] += rng.uniform(-12, 12, (int(wrong.sum()), 2))
        spoiled.append(dataclasses.replace(view, pixels=pixels))

    ours = calibrate(spoiled, left_board)
    plain = plain_cv2(spoiled, left_board)

    mine = held_out(ours.parameters, real_points(ours.fit, left_board), test)
    assert mine < held_out(plain, left_board.points, test)
    assert mine < 0.22


def test_views_of_one_side_predict_the_others_better_than_plain_cv2(
    left_views: list[View], left_board: Board
) -> None:
    squares = []
    for axis, sign in ((0, -1), (1, 1), (1, -1)):
        order = np.argsort([sign * float(v.pixels[:, axis].mean()) for v in left_views])
        train, test = [left_views[i] for i in order[:6]], [left_views[i] for i in order[6:]]
        ours = calibrate(train, left_board)
        plain = plain_cv2(train, left_board)
        squares.append(
            [
                held_out(ours.parameters, real_points(ours.fit, left_board), test) ** 2,
                held_out(plain, left_board.points, test) ** 2,
            ]
        )

    mine, theirs = np.sqrt(np.mean(squares, axis=0))
    assert mine < theirs


# Known truth.


def test_derivatives_of_the_lens_are_those_of_finite_differences() -> None:
    rng = np.random.default_rng(0)
    points = rng.uniform(-0.3, 0.3, (20, 3)) + [0, 0, 1.0]
    for d in (0, 4, 5, 8):
        p = np.concatenate([[600.0, 610.0, 320.0, 240.0], rng.uniform(-0.1, 0.1, d)])
        _, by_point, by_parameter = project_jacobian(p, points)
        step = 1e-6
        for k in range(3):
            e = step * np.eye(3)[k]
            slope = (project(p, points + e) - project(p, points - e)) / (2 * step)
            assert np.allclose(slope, by_point[:, :, k], atol=1e-4)
        for k in range(p.size):
            e = step * np.eye(p.size)[k]
            slope = (project(p + e, points) - project(p - e, points)) / (2 * step)
            assert np.allclose(slope, by_parameter[:, :, k], atol=1e-4)


@pytest.mark.parametrize("d", [0, 4, 5, 8])
def test_the_lens_is_opencvs(d: int) -> None:
    rng = np.random.default_rng(d)
    points = rng.uniform(-0.3, 0.3, (50, 3)) + [0, 0, 1.0]
    k = rng.uniform(-0.1, 0.1, d)
    K = np.array([[600.0, 0, 320.0], [0, 610.0, 240.0], [0, 0, 1.0]])

    reference, _ = cv2.projectPoints(
        objectPoints=points, rvec=np.zeros(3), tvec=np.zeros(3), cameraMatrix=K,
        distCoeffs=k if d else np.zeros(5),
    )  # fmt: skip

    pixels = project(vector(K, k), points)
    assert np.allclose(pixels, reference.reshape(-1, 2), atol=1e-9)
    back = directions(vector(K, k), pixels)
    assert np.allclose(back, points[:, :2] / points[:, 2:], atol=1e-9)


def test_the_block_solver_finds_the_minimum_that_scipy_finds() -> None:
    views = made(5, 6)
    result = fit(views, BOARD, model=4, shape="flat")
    T = result.state.T_camera_board

    def residual(x: Float) -> Float:
        parts = []
        for n, view in enumerate(views):
            step = x[8 + 6 * n : 14 + 6 * n]
            moved = rigid.stepped(T[n], step)
            local = BOARD.points[view.ids] @ moved[:3, :3].T + moved[:3, 3]
            parts.append((project(x[:8], local) - view.pixels)[result.inliers[n]].ravel())
        return np.concatenate(parts)

    start = np.concatenate([result.state.parameters + 0.01, np.zeros(6 * len(views))])
    reference = least_squares(residual, start, x_scale="jac", xtol=1e-14, ftol=1e-14)

    assert np.allclose(result.state.parameters, reference.x[:8], rtol=1e-3, atol=1e-3)
    J = reference.jac
    variance = 2 * reference.cost / (len(J) - J.shape[1])
    covariance = variance * np.linalg.inv(J.T @ J)[:8, :8]
    assert np.allclose(np.sqrt(np.diag(result.covariance)), np.sqrt(np.diag(covariance)), rtol=0.03)


def test_without_noise_the_truth_is_found_exactly() -> None:
    model = synthetic.camera()

    result = fit(made(1, noise=0.0), BOARD, model=4, shape="flat")

    assert np.allclose(result.state.parameters, vector(model.K, model.distortion), atol=2e-4)


@pytest.mark.parametrize("seeds", [pytest.param(20), pytest.param(100, marks=pytest.mark.slow)])
def test_the_stated_uncertainty_of_the_intrinsics_is_right(seeds: int) -> None:
    model = synthetic.camera()
    truth = vector(model.K, model.distortion)
    limit, inside = float(chi2.ppf(0.95, truth.size)), 0

    for seed in range(seeds):
        result = fit(made(seed), BOARD, model=4, shape="warp")
        error = result.state.parameters - truth
        inside += int(error @ np.linalg.solve(result.covariance[:8, :8], error) < limit)

    # 16 of 20 or fewer has a chance of 1.6 %, 89 of 100 or fewer 1.1 %.
    assert inside >= 17 if seeds == 20 else 90 <= inside <= 99


def test_the_stated_uncertainty_of_projections_is_what_happens() -> None:
    model = synthetic.camera()
    truth = vector(model.K, model.distortion)
    u, v = np.meshgrid(np.linspace(0, 639, 9), np.linspace(0, 479, 7))
    rays = np.concatenate(
        [directions(truth, np.stack([u.ravel(), v.ravel()], 1)), np.ones((63, 1))], axis=1
    )
    ratios = []
    for seed in range(8):
        result = calibrate(made(seed), BOARD, Options(model=4, shape="flat", folds=2))
        # A turn of the camera is no error of projection.
        best = least_squares(
            lambda w, p=result.parameters: (
                project(p, rays @ rigid.exp(w).T) - project(truth, rays)
            ).ravel(),
            np.zeros(3),
        )
        happened = np.sqrt((best.fun**2).sum() / 63)
        ratios.append(happened / np.sqrt((result.uncertainty.sd**2).mean()))

    assert 0.4 < float(np.median(ratios)) < 1.6


def test_a_bent_board_is_found_and_does_not_bend_the_camera() -> None:
    rng = np.random.default_rng(3)
    bent = np.array(BOARD.points)
    x = 2 * bent[:, 0] / bent[:, 0].max() - 1
    bent[:, 2] += 0.002 * (1 - x**2)
    poses = synthetic.board_poses(rng, BOARD, 25)
    model = synthetic.camera()
    views = [
        v
        for v in synthetic.views(rng, BOARD, model, poses, noise=0.1, points=bent)
        if len(v.ids) >= 20
    ]

    result = calibrate(views, BOARD)

    assert result.fit.board_shape == "warp"
    assert result.fit.state.shape[0] == pytest.approx(0.002, abs=1e-4)
    assert result.parameters[0] == pytest.approx(model.K[0, 0], abs=2.0)
    assert any(w.startswith("the board is bent by 2.0") for w in result.warnings)


def test_held_out_views_choose_no_more_coefficients_than_the_lens_has() -> None:
    rng = np.random.default_rng(7)
    chosen = []
    for k in ((), (0.06, -0.15, 0.0008, -0.0005)):
        poses = synthetic.board_poses(rng, BOARD, 20)
        model = synthetic.camera(distortion=k)
        views = [v for v in synthetic.views(rng, BOARD, model, poses) if len(v.ids) >= 20]
        chosen.append(calibrate(views, BOARD).parameters.size - 4)

    assert chosen == [0, 5]


def test_a_picture_of_another_board_is_dropped_and_named() -> None:
    views = made(2)
    wrong = dataclasses.replace(
        views[3], pixels=views[3].pixels + np.random.default_rng(0).normal(size=(54, 2)) * 8
        if len(views[3].ids) == 54 else views[3].pixels[::-1],
    )  # fmt: skip

    result = calibrate([*views[:3], wrong, *views[4:]], BOARD)

    assert list(result.dropped) == [views[3].name]
    assert result.parameters[0] == pytest.approx(615.6, abs=4.0)


def test_two_pictures_are_too_few() -> None:
    with pytest.raises(CalibrationError) as caught:
        calibrate(made(0)[:2], BOARD)

    assert str(caught.value) == (
        "expected at least 3 pictures with the board, found 2; take 15 or more, tilted in "
        "different directions"
    )


def test_pictures_that_are_all_alike_are_refused() -> None:
    rng = np.random.default_rng(0)
    poses = synthetic.board_poses(rng, BOARD, 10, tilt=0.02)
    views = synthetic.views(rng, BOARD, synthetic.camera(), poses)

    with pytest.raises(DegenerateData, match="all 10 pictures are alike: the board's normals"):
        calibrate(views, BOARD)


def test_weak_tilt_and_few_pictures_are_warned_of() -> None:
    result = calibrate(made(4, 8, tilt=0.2), BOARD)

    assert any("the focal length is weak" in w for w in result.warnings)
    assert any("pictures took part; 15 or more" in w for w in result.warnings)


def test_mixed_resolutions_are_refused() -> None:
    views = made(0)
    other = dataclasses.replace(views[1], size=(1280, 720))

    with pytest.raises(CalibrationError, match="expected pictures of one resolution"):
        calibrate([views[0], other, *views[2:]], BOARD)


def test_pure_noise_has_no_correlation_and_an_inexact_print_has() -> None:
    rng = np.random.default_rng(0)
    poses = synthetic.board_poses(rng, BOARD, 20)
    smooth = np.array(BOARD.points)
    smooth[:, 0] += 2e-4 * np.sin(40 * BOARD.points[:, 0]) * np.cos(40 * BOARD.points[:, 1])

    factors = []
    for points in (BOARD.points, smooth):
        views = synthetic.views(rng, BOARD, synthetic.camera(), poses, noise=0.1, points=points)
        views = [v for v in views if len(v.ids) >= 20]
        factors.append(correlation(fit(views, BOARD, model=4, shape="warp")))

    assert factors[0] < 1.05
    assert factors[1] > 1.2


def test_a_blurred_picture_counts_less() -> None:
    views = made(6, noise=0.1)
    rng = np.random.default_rng(1)
    blurred = dataclasses.replace(
        views[2], pixels=views[2].pixels + 0.2 * rng.normal(size=views[2].pixels.shape)
    )

    result = fit([*views[:2], blurred, *views[3:]], BOARD, model=4, shape="flat")

    assert result.scales[2] > 1.7
    assert np.median(np.delete(result.scales, 2)) == pytest.approx(1.0, abs=0.1)
    assert result.inliers[2].mean() > 0.95
