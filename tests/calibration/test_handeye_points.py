from __future__ import annotations

import numpy as np
import pytest
from clothrf_calibration import rigid, synthetic
from clothrf_calibration.boardpose import fit_pose
from clothrf_calibration.boards import Board
from clothrf_calibration.errors import DegenerateData
from clothrf_calibration.handeye_points import fit_points
from clothrf_calibration.lens import vector
from scipy.stats import chi2

from clothrf_core.types import Float

BOARD = Board(kind="charuco", columns=10, rows=7, square=0.02)
MODEL = synthetic.camera()


def seen(seed: int, count: int = 20, **options: float) -> tuple[synthetic.HandEyeRig, Float, Float]:
    r = synthetic.hand_eye_rig(np.random.default_rng(seed), BOARD, MODEL, count, **options)
    keep = [i for i, v in enumerate(r.views) if len(v.ids) >= 8]
    parameters = vector(MODEL.K, MODEL.distortion)
    C = np.stack([fit_pose(parameters, BOARD.points, r.views[i])[0] for i in keep])
    return r, r.T_base_gripper[keep][:, :3, 3], C


def test_without_noise_positions_alone_give_the_camera() -> None:
    r, p, C = seen(0, noise=0.0)

    found = fit_points(p, C)

    assert np.allclose(found.T_base_camera, r.X, atol=1e-5)
    assert np.allclose(found.point, rigid.inverse(r.Z)[:3, 3], atol=1e-5)


def test_positions_alone_give_the_camera_to_a_few_millimetres() -> None:
    errors = []
    for seed in range(10):
        r, p, C = seen(seed, robot_mm=0.2)
        found = fit_points(p, C)
        errors.append(1e3 * np.linalg.norm(found.T_base_camera[:3, 3] - r.X[:3, 3]))

    assert np.median(errors) < 3.0


def test_the_stated_uncertainty_is_about_right() -> None:
    inside = 0
    for seed in range(30):
        r, p, C = seen(seed, robot_mm=0.5)
        found = fit_points(p, C)
        d = found.T_base_camera @ rigid.inverse(r.X)
        x = np.concatenate([rigid.log(d[:3, :3]), found.T_base_camera[:3, 3] - r.X[:3, 3]])
        inside += int(x @ np.linalg.solve(found.covariance, x) < chi2.ppf(0.95, 6))

    assert inside >= 22


def test_four_positions_are_too_few() -> None:
    _, p, C = seen(0)

    with pytest.raises(DegenerateData, match="expected at least 5 gripper positions"):
        fit_points(p[:4], C[:4])
