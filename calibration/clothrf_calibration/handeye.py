"""Where the camera stands: from board pictures and robot poses to a pose of known quality."""

from __future__ import annotations

import dataclasses
from collections.abc import Callable, Sequence

import numpy as np

from clothrf_calibration import rigid
from clothrf_calibration.boardpose import fit_pose
from clothrf_calibration.boards import Board
from clothrf_calibration.errors import CalibrationError, DegenerateData
from clothrf_calibration.handeye_fit import (
    HandEyeFit,
    HandEyeProblem,
    RobotNoise,
    Setup,
    refine,
)
from clothrf_calibration.handeye_judge import held_out, measured_scale, start_error, view_rms
from clothrf_calibration.handeye_start import starts
from clothrf_calibration.motion import Motion, motion, refuse_degenerate, unflipped
from clothrf_calibration.robotnoise import refine_with_noise
from clothrf_calibration.threads import one_thread
from clothrf_calibration.views import View
from clothrf_core.types import Float

MIN_POSES = 3
CORNER_SIGMA = 4.5
SCALE_SIGMA, SCALE_SHARE = 3.0, 0.003
OTHER_SETUP = 0.4
BAD_VIEW = 5.0
HOPELESS_DEG = 3.0


@dataclasses.dataclass(frozen=True, slots=True, eq=False)
class HandEye:
    """The result and all that is known about its quality.

    Attributes:
        setup: ``fixed`` (camera stands, board on the gripper) or ``hand`` (camera on the gripper).
        names: (V) names of the views that took part.
        X: (4, 4) T_base_camera (fixed) or T_gripper_camera (hand).
        Z: (4, 4) T_gripper_board (fixed) or T_base_board (hand).
        covariance: (6, 6) of X: left turn (rad), then shift (m).
        intrinsics: (4 + D,) refined within their covariance, or as they were given.
        intrinsics_covariance: (4 + D, 4 + D) after the refinement; None if they were fixed.
        noise: estimated inexactness of the robot.
        sigma: noise of one coordinate of a corner, pixels.
        rms: (V,) reprojection error of each view from the robot's pose alone, pixels.
        held_out_px: (V,) the same for views that did not take part.
        held_out_mm: (V,) position error of the board for views that did not take part.
        held_out_deg: (V,) its rotation error.
        start: name of the closed-form method that the refinement started from.
        starts: method -> reprojection error at its solution, pixels.
        scale: board scale measured by the robot, and its standard deviation; 1 = as stated.
        motion: strength and consistency of the motions.
        dropped: view -> why it took no part.
        turned: views whose symmetric board was read upside down and put right.
        warnings: what the user should know.
    """

    setup: Setup
    names: tuple[str, ...]
    X: Float
    Z: Float
    covariance: Float
    intrinsics: Float
    intrinsics_covariance: Float | None
    noise: RobotNoise
    sigma: float
    rms: Float
    held_out_px: Float
    held_out_mm: Float
    held_out_deg: Float
    start: str
    starts: dict[str, float]
    scale: tuple[float, float]
    motion: Motion
    dropped: dict[str, str]
    turned: tuple[str, ...]
    warnings: tuple[str, ...]

    @property
    def sd_mm(self) -> float:
        """Standard deviation of the camera's position, mm (root of the trace)."""
        return 1e3 * float(np.sqrt(np.trace(self.covariance[3:, 3:])))

    @property
    def sd_deg(self) -> float:
        """Standard deviation of the camera's rotation, degrees (root of the trace)."""
        return float(np.degrees(np.sqrt(np.trace(self.covariance[:3, :3]))))


def hand_eye(
    views: Sequence[View],
    T_base_gripper: Float,
    board: Board,
    intrinsics: Float,
    *,
    setup: Setup = "fixed",
    covariance: Float | None = None,
    points: Float | None = None,
    robot: RobotNoise | None = None,
    step: Callable[[str, int, int], None] | None = None,
) -> HandEye:
    """Solve for the camera's pose.

    Args:
        views: one for every robot pose; an empty view counts as not seen.
        T_base_gripper: (V, 4, 4) as the robot reports.
        board: the board.
        intrinsics: (4 + D,) intrinsic vector.
        setup: who stands still.
        covariance: of the intrinsics; they are then refined within it.
        points: (P, 3) of the board as it is, if known.
        robot: how inexact its poses are; None = found out from the data.
        step: called with (what, done, of).

    Raises:
        CalibrationError: numbers of views and poses differ, the wrong setup, the wrong board size.
        DegenerateData: the motion leaves something undetermined.
    """
    if len(views) != len(T_base_gripper):
        raise CalibrationError(
            f"expected a pose for every picture, found {len(views)} pictures and "
            f"{len(T_base_gripper)} poses; give every pose the name of its picture"
        )
    tell = step or (lambda what, done, of: None)
    with one_thread():
        return _hand_eye(
            views, T_base_gripper, board, intrinsics, setup, covariance, points, robot, tell
        )


def _hand_eye(
    views: Sequence[View],
    T_base_gripper: Float,
    board: Board,
    intrinsics: Float,
    setup: Setup,
    covariance: Float | None,
    points: Float | None,
    robot: RobotNoise | None,
    tell: Callable[[str, int, int], None],
) -> HandEye:
    real = board.points if points is None else points
    dropped = {v.name: "no board found" for v in views if len(v.ids) < 6}
    chosen = [i for i, v in enumerate(views) if len(v.ids) >= 6]
    if len(chosen) < MIN_POSES:
        raise DegenerateData(
            f"expected at least {MIN_POSES} poses with the board in view, found {len(chosen)}; "
            "take 15 to 25, turned about different axes"
        )
    tell("board poses", 0, 8)
    seen, C, sigma = _clean([views[i] for i in chosen], real, intrinsics)
    A_all = T_base_gripper[chosen]
    A = A_all if setup == "fixed" else rigid.inverse(A_all)
    C, flips = unflipped(A, C, board)
    seen = [_turned(v, board) if f else v for v, f in zip(seen, flips, strict=True)]
    turned = tuple(v.name for v, f in zip(seen, flips, strict=True) if f)
    found = motion(A, C)
    say = refuse_degenerate(found, len(seen), setup=setup)
    if found.median > HOPELESS_DEG:
        raise CalibrationError(
            f"poses and pictures do not belong together: robot and camera disagree by "
            f"{found.median:.1f} degrees (median) about how far things turned; check the order of "
            "the poses and that they are the gripper's in the base"
        )
    keep = np.ones(len(seen), bool)
    if len(seen) >= 6 and found.bad.mean() <= 0.34:
        for n in np.nonzero(found.bad)[0]:
            keep[n] = False
            dropped[seen[n].name] = (
                f"robot and camera disagree by {found.disagreement[n]:.2f} degrees about its turn"
            )
    problem = HandEyeProblem(
        setup, A[keep], [v for v, k in zip(seen, keep, strict=True) if k], real, sigma, intrinsics,
        covariance=covariance,
    )  # fmt: skip
    tell("closed forms", 1, 8)
    name, (X, Z), errors = best_start(problem, C[keep])
    _refuse_other_setup(problem, C[keep], A_all[keep], errors[name])
    tell("joint refinement", 2, 8)
    result, noise = _refined(problem, X, Z, robot)
    problem, result, noise, late = _drop_bad_views(problem, result, noise, robot)
    dropped |= late
    tell("board scale", 3, 8)
    scale = measured_scale(problem, result, noise)
    rms = view_rms(problem, result)
    px, mm, deg = held_out(problem, result, noise, tell)
    tell("solved", 8, 8)
    say += _warnings(scale, sigma, rms, px, noise, dropped, turned, result, board)
    return HandEye(
        setup=setup,
        names=tuple(v.name for v in problem.views),
        X=result.pose,
        Z=result.state.Z,
        covariance=result.pose_covariance,
        intrinsics=result.state.parameters,
        intrinsics_covariance=None
        if covariance is None
        else result.covariance[problem.columns[3], problem.columns[3]],
        noise=noise,
        sigma=sigma,
        rms=rms,
        held_out_px=px,
        held_out_mm=mm,
        held_out_deg=deg,
        start=name,
        starts=errors,
        scale=scale,
        motion=found,
        dropped=dropped,
        turned=turned,
        warnings=tuple(say),
    )


def best_start(
    problem: HandEyeProblem, C: Float
) -> tuple[str, tuple[Float, Float], dict[str, float]]:
    """The closed form with the smallest reprojection error, and the errors of all."""
    found = starts(problem.A, C)
    errors = {name: start_error(problem, X, Z) for name, (X, Z) in found.items()}
    if not errors:
        raise DegenerateData(
            "no closed-form hand-eye solution exists for these poses; check that poses and "
            "pictures belong together and turn the gripper about more axes"
        )
    name = min(errors, key=lambda n: errors[n])
    return name, found[name], errors


def _refined(
    problem: HandEyeProblem, X: Float, Z: Float, robot: RobotNoise | None
) -> tuple[HandEyeFit, RobotNoise]:
    if robot is not None:
        return refine(dataclasses.replace(problem, noise=robot), X, Z), robot
    return refine_with_noise(problem, X, Z)


def _drop_bad_views(
    problem: HandEyeProblem, result: HandEyeFit, noise: RobotNoise, robot: RobotNoise | None
) -> tuple[HandEyeProblem, HandEyeFit, RobotNoise, dict[str, str]]:
    """Leave out views far worse than the others, one after another, and solve again."""
    dropped: dict[str, str] = {}
    while len(problem.views) > max(MIN_POSES, 5):
        rms = view_rms(problem, result)
        worst = int(np.argmax(rms))
        limit = BAD_VIEW * max(float(np.median(rms)), 1.5 * problem.sigma)
        if rms[worst] < limit or len(dropped) > 0.3 * (len(rms) + len(dropped)):
            break
        dropped[problem.views[worst].name] = (
            f"its corners are {rms[worst]:.1f} px from where the robot's pose puts them"
        )
        keep = np.arange(len(rms)) != worst
        problem = dataclasses.replace(
            problem,
            A=problem.A[keep],
            views=[v for v, k in zip(problem.views, keep, strict=True) if k],
        )
        result, noise = _refined(problem, result.pose, result.state.Z, robot)
    return problem, result, noise, dropped


def _clean(
    views: Sequence[View], points: Float, intrinsics: Float
) -> tuple[list[View], Float, float]:
    """Views without outlying corners, their board poses and the corner noise in pixels."""
    poses, residuals = [], []
    for view in views:
        T, r = fit_pose(intrinsics, points, view)
        poses.append(T)
        residuals.append(r)
    distance = np.concatenate([np.linalg.norm(r, axis=1) for r in residuals])
    limit = CORNER_SIGMA * max(float(np.median(distance)) / 1.177, 0.02)
    result = []
    for n, (view, r) in enumerate(zip(views, residuals, strict=True)):
        mask = np.linalg.norm(r, axis=1) <= limit
        if mask.all() or mask.sum() < 6:
            result.append(view)
            continue
        result.append(view.keep(mask))
        poses[n], residuals[n] = fit_pose(intrinsics, points, result[-1])
    squares = sum(float((r**2).sum()) for r in residuals)
    dof = sum(2 * len(r) - 6 for r in residuals)
    return result, np.stack(poses), float(np.sqrt(squares / max(dof, 1)))


def _refuse_other_setup(problem: HandEyeProblem, C: Float, G: Float, error: float) -> None:
    other: Setup = "hand" if problem.setup == "fixed" else "fixed"
    A = G if other == "fixed" else rigid.inverse(G)
    trial = dataclasses.replace(problem, setup=other, A=A)
    errors = [start_error(trial, X, Z) for X, Z in starts(A, C).values()]
    if errors and min(errors) < OTHER_SETUP * error and error > 5.0:
        raise CalibrationError(
            f"the poses fit a camera {_phrase(other)} ({min(errors):.1f} px), not one "
            f"{_phrase(problem.setup)} ({error:.1f} px); pass --setup {other}"
        )


def _phrase(setup: Setup) -> str:
    return "on the hand" if setup == "hand" else "that stands still"


def _turned(view: View, board: Board) -> View:
    return dataclasses.replace(view, ids=len(board.points) - 1 - view.ids)


def _warnings(
    scale: tuple[float, float],
    sigma: float,
    rms: Float,
    px: Float,
    noise: RobotNoise,
    dropped: dict[str, str],
    turned: tuple[str, ...],
    result: HandEyeFit,
    board: Board,
) -> list[str]:
    say = []
    off = abs(scale[0] - 1.0)
    if off > SCALE_SIGMA * scale[1] and off > SCALE_SHARE:
        say.append(
            f"the robot measures squares of {board.square * scale[0] * 1e3:.3f} mm "
            f"(+- {board.square * scale[1] * 1e3:.3f}), the board file says "
            f"{board.square * 1e3:g} mm: measure the print, or recalibrate the focal length"
        )
    total = float(np.sqrt((rms**2).mean()))
    if total > 5.0 * np.sqrt(2.0) * sigma and total > 1.0:
        say.append(
            f"the robot's poses explain the corners to {total:.2f} px only, the pictures alone to "
            f"{np.sqrt(2.0) * sigma:.2f} px: robot off by about {noise.shift * 1e3:.2f} mm and "
            f"{np.degrees(noise.turn):.3f} degrees an axis, or bad intrinsics"
        )
    sd = np.sqrt(np.trace(result.pose_covariance[3:, 3:]))
    if sd > 2e-3:
        say.append(
            f"the camera's position is uncertain by {1e3 * sd:.1f} mm; add poses with more turns"
        )
    if turned:
        say.append(
            f"{len(turned)} pictures of the symmetric board were read upside down and put right; "
            "a ChArUco board cannot be mistaken"
        )
    say += [f"{name} took no part: {why}" for name, why in dropped.items()]
    if np.isfinite(px).all() and np.sqrt((px**2).mean()) > 2.0 * max(total, np.sqrt(2.0) * sigma):
        say.append("held-out views are twice as bad as the fit; take more poses")
    return say
