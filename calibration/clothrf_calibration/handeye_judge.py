"""How well a hand-eye result predicts what the camera sees, of views in the fit and held out."""

from __future__ import annotations

import dataclasses
from collections.abc import Callable

import numpy as np

from clothrf_calibration import rigid
from clothrf_calibration.boardpose import fit_pose
from clothrf_calibration.crossvalidation import folds
from clothrf_calibration.handeye_fit import HandEyeFit, HandEyeProblem, RobotNoise, refine
from clothrf_calibration.lens import project
from clothrf_core.types import Float

MIN_TRAIN = 3


def view_rms(problem: HandEyeProblem, result: HandEyeFit) -> Float:
    """(V,) reprojection error of each view from the robot's pose alone, pixels."""
    return np.array(
        [
            float(np.sqrt((r**2).sum(axis=1).mean()))
            for r in residuals(problem, result.state.Y, result.state.Z, result.state.parameters)
        ]
    )


def held_out(
    problem: HandEyeProblem,
    result: HandEyeFit,
    noise: RobotNoise,
    tell: Callable[[str, int, int], None] = lambda what, done, of: None,
    *,
    k: int = 5,
) -> tuple[Float, Float, Float]:
    """(V,) pixels, mm and degrees by which views not used miss their prediction by the robot."""
    n = len(problem.A)
    px, mm, deg = np.zeros(n), np.zeros(n), np.zeros(n)
    if n < MIN_TRAIN + 2:
        return px * np.nan, mm * np.nan, deg * np.nan
    for number, held in enumerate(folds(n, k)):
        train = np.setdiff1d(np.arange(n), held)
        part = dataclasses.replace(
            problem,
            A=problem.A[train],
            views=[problem.views[i] for i in train],
            noise=noise,
        )
        fit = refine(part, result.pose, result.state.Z)
        test = dataclasses.replace(
            problem, A=problem.A[held], views=[problem.views[i] for i in held]
        )
        px[held] = view_rms(test, fit)
        for i in held:
            seen, _ = fit_pose(fit.state.parameters, problem.points, problem.views[i])
            mm[i], deg[i] = _apart(seen, fit.state.Y @ problem.A[i] @ fit.state.Z, problem.points)
        tell("held-out views", 3 + number, 8)
    return px, mm, deg


def measured_scale(
    problem: HandEyeProblem, result: HandEyeFit, noise: RobotNoise
) -> tuple[float, float]:
    """Board scale by the robot's motion, and its standard deviation; a wrong square size shows."""
    free = dataclasses.replace(problem, noise=noise, free_scale=True)
    fit = refine(free, result.pose, result.state.Z)
    return fit.state.scale, float(np.sqrt(fit.covariance[12, 12]))


def residuals(problem: HandEyeProblem, Y: Float, Z: Float, parameters: Float) -> list[Float]:
    """(N, 2) pixels of every view, measured minus predicted from the robot's pose alone."""
    result = []
    for A, view in zip(problem.A, problem.views, strict=True):
        C = Y @ A @ Z
        local = problem.points[view.ids] @ C[:3, :3].T + C[:3, 3]
        local[local[:, 2] < 1e-3, 2] = 1e-3
        with np.errstate(over="ignore", invalid="ignore"):
            result.append(view.pixels - project(parameters, local))
    return result


def start_error(problem: HandEyeProblem, X: Float, Z: Float) -> float:
    """Median over the views of their reprojection error, pixels."""
    found = residuals(problem, rigid.inverse(X), Z, problem.intrinsics)
    each = [float(np.sqrt((np.minimum(np.abs(r), 1e4) ** 2).sum(axis=1).mean())) for r in found]
    return float(np.median(each))


def _apart(T: Float, other: Float, points: Float) -> tuple[float, float]:
    """Distance in mm of the board's middle, and angle in degrees, between two board poses."""
    middle = points.mean(axis=0)
    shift = (T[:3, :3] - other[:3, :3]) @ middle + T[:3, 3] - other[:3, 3]
    return 1e3 * float(np.linalg.norm(shift)), float(rigid.angle_deg(T[:3, :3] @ other[:3, :3].T))
