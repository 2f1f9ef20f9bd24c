"""Intrinsics, board shape and board poses that explain all views best: one robust fit.

Start values from ``cv2.calibrateCamera``; then iterated Cauchy weights (Holland and Welsch 1977),
rejection of single corners, and plain least squares on what is left, so that the covariance means
what it says.
"""

from __future__ import annotations

import dataclasses
from collections.abc import Sequence

import cv2
import numpy as np
from numpy.typing import NDArray
from typing_extensions import override

from clothrf_calibration import rigid
from clothrf_calibration.boards import Board
from clothrf_calibration.boardshape import (
    FREE_SIGMA,
    Shape,
    deformed,
    shape_basis,
    shape_size,
)
from clothrf_calibration.bundle import Block, Problem, Solution, inverse_information, solve
from clothrf_calibration.errors import CalibrationError
from clothrf_calibration.lens import project_jacobian, vector
from clothrf_calibration.views import View
from clothrf_core.types import Float

REJECT_SIGMA = 4.5
CAUCHY = 2.385
MIN_KEPT = 0.5
# A view's noise may differ this much from the usual; a median of few corners counts as SHRINK.
SCALES = (0.5, 2.5)
SHRINK = 20.0

# How large distortion coefficients k1 k2 p1 p2 k3 k4 k5 k6 of a lens may be. Where pictures leave
# one undetermined (half of the image empty), this keeps it from running away; where they
# determine it, it has no effect. Weighed against a usual corner noise.
PRIOR_SD = np.array([1.0, 1.0, 0.1, 0.1, 1.0, 1.0, 1.0, 1.0])
PRIOR_PIXELS = 0.2


@dataclasses.dataclass(frozen=True, slots=True, eq=False)
class State:
    """Everything that is solved for.

    Attributes:
        parameters: (4 + D,) intrinsic vector (`clothrf_calibration.lens`).
        shape: (B,) numbers of the board's deviation.
        T_camera_board: (V, 4, 4) a pose for every view.
    """

    parameters: Float
    shape: Float
    T_camera_board: Float


@dataclasses.dataclass(frozen=True, slots=True, eq=False)
class Fit:
    """A robust fit.

    Attributes:
        state: the numbers.
        board_shape: which deviation of the board was allowed.
        views: all views, in the order of the poses.
        inliers: for every view (N,) bool, the corners that were believed.
        scales: (V,) noise of each view over `sigma`.
        residuals: for every view (N, 2) pixels measured minus projected, of all corners.
        sigma: usual noise of one coordinate, pixels, estimated from the inliers.
        covariance: (4 + D + B, 4 + D + B) of parameters and shape.
        converged: the solver reached its minimum.
    """

    state: State
    board_shape: Shape
    views: tuple[View, ...]
    inliers: tuple[NDArray[np.bool_], ...]
    scales: Float
    residuals: tuple[Float, ...]
    sigma: float
    covariance: Float
    converged: bool

    @property
    def belief(self) -> Belief:
        """Corners and views as this fit judged them."""
        return Belief(self.inliers, self.scales)

    @property
    def rms(self) -> float:
        """Root mean square distance of the inliers, pixels (OpenCV's definition)."""
        squares = [r[m] ** 2 for r, m in zip(self.residuals, self.inliers, strict=True)]
        return float(np.sqrt(2.0 * np.concatenate(squares).mean()))

    @property
    def rejected(self) -> int:
        """Corners that were not believed."""
        return int(sum((~m).sum() for m in self.inliers))


@dataclasses.dataclass(frozen=True, slots=True, eq=False)
class _Intrinsics(Problem[State]):
    """The reprojection problem; weights are square roots."""

    views: Sequence[View]
    weights: Sequence[Float]
    points: Float
    basis: Float
    free: bool

    def _project(self, state: State) -> tuple[Float, Float, Float]:
        """Residuals of all corners of all views and their derivatives."""
        points = self.points + self.basis @ state.shape
        ids = np.concatenate([v.ids for v in self.views])
        view = np.repeat(np.arange(len(self.views)), [len(v.ids) for v in self.views])
        R, t = state.T_camera_board[view, :3, :3], state.T_camera_board[view, :3, 3]
        turned = (R @ points[ids, :, None])[:, :, 0]
        pixels, by_point, by_parameter = project_jacobian(state.parameters, turned + t)
        measured = np.concatenate([v.pixels for v in self.views])
        by_shape = by_point @ R @ self.basis[ids] if self.basis.shape[2] else by_point[:, :, :0]
        by_shared = np.concatenate([by_parameter, by_shape], axis=2)
        by_own = np.concatenate([-by_point @ rigid.skew(turned), by_point], axis=2)
        return pixels - measured, by_shared, by_own

    @override
    def blocks(self, state: State) -> list[Block]:
        residual, by_shared, by_own = self._project(state)
        w = np.concatenate(list(self.weights))
        residual = residual * w[:, None]
        by_shared = by_shared * w[:, None, None]
        by_own = by_own * w[:, None, None]
        cuts = np.cumsum([len(v.ids) for v in self.views])[:-1]
        return [
            Block(r.ravel(), s.reshape(-1, s.shape[2]), o.reshape(-1, 6))
            for r, s, o in zip(
                np.split(residual, cuts),
                np.split(by_shared, cuts),
                np.split(by_own, cuts),
                strict=True,
            )
        ]

    @override
    def prior(self, state: State) -> tuple[Float, Float]:
        n, b = state.parameters.size, state.shape.size
        width = np.concatenate([PRIOR_SD[: n - 4], np.full(b if self.free else 0, FREE_SIGMA)])
        scale = PRIOR_PIXELS / width
        value = np.concatenate([state.parameters[4:], state.shape if self.free else np.zeros(0)])
        J = np.zeros((len(value), n + b))
        J[np.arange(len(value)), 4 + np.arange(len(value))] = scale
        return scale * value, J

    @override
    def cost(self, state: State) -> float:
        residual = self.residual(state) * np.concatenate(list(self.weights))[:, None]
        return float((residual**2).sum() + (self.prior(state)[0] ** 2).sum())

    def residual(self, state: State) -> Float:
        """(M, 2) unweighted; huge where a point is behind the camera."""
        points = self.points + self.basis @ state.shape
        ids = np.concatenate([v.ids for v in self.views])
        view = np.repeat(np.arange(len(self.views)), [len(v.ids) for v in self.views])
        R, t = state.T_camera_board[view, :3, :3], state.T_camera_board[view, :3, 3]
        local = (R @ points[ids, :, None])[:, :, 0] + t
        behind = local[:, 2] < 1e-6
        local[behind, 2] = 1e-6
        with np.errstate(over="ignore", invalid="ignore"):
            pixels = project_jacobian(state.parameters, local)[0]
        measured = np.concatenate([v.pixels for v in self.views])
        return np.where(behind[:, None], 1e6, pixels - measured)

    @override
    def moved(self, state: State, shared: Float, own: Sequence[Float]) -> State:
        n = state.parameters.size
        return State(
            state.parameters + shared[:n],
            state.shape + shared[n:],
            rigid.stepped(state.T_camera_board, np.stack(own)),
        )


@dataclasses.dataclass(frozen=True, slots=True, eq=False)
class Belief:
    """What is believed of the data.

    Attributes:
        inliers: for every view (N,) bool, the corners that are used.
        scales: (V,) noise of each view over the usual noise; a blurred picture counts less.
    """

    inliers: tuple[NDArray[np.bool_], ...]
    scales: Float

    @property
    def weights(self) -> list[Float]:
        """For every view (N,) square roots of weights."""
        return [m / s for m, s in zip(self.inliers, self.scales, strict=True)]


def fit(
    views: Sequence[View],
    board: Board,
    *,
    model: int = 5,
    shape: Shape = "warp",
    start: State | None = None,
    belief: Belief | None = None,
) -> Fit:
    """Fit `model` distortion coefficients and the board's `shape` to all `views`.

    Args:
        views: at least three.
        board: the board as drawn.
        model: 0, 4, 5 or 8 distortion coefficients.
        shape: deviation of the board that is solved for.
        start: state to start from, its numbers cut or padded with zeros as needed.
        belief: of another fit; given, nothing is judged anew.

    Raises:
        CalibrationError: no start value can be found.
    """
    state = _resized(start or first_guess(views, board), model, shape_size(board, shape))
    every = Belief(tuple(np.ones(len(v.ids), bool) for v in views), np.ones(len(views)))
    problem = _Intrinsics(
        views, (belief or every).weights, board.points, shape_basis(board, shape), shape == "free"
    )
    if belief is None:
        for _ in range(4):
            weights = _doubt(problem.residual(state), views)
            problem = dataclasses.replace(problem, weights=weights)
            state, _ = solve(problem, state, iterations=15, tolerance=1e-5)
    believed = belief or every
    for n in range(1 if belief is not None else 8):
        if belief is None:
            new = _judge(problem.residual(state), views, believed)
            same = all((a == b).all() for a, b in zip(new.inliers, believed.inliers, strict=True))
            if n > 1 and same:
                break
            believed = new
        problem = dataclasses.replace(problem, weights=believed.weights)
        state, solution = solve(problem, state)
    return _fitted(problem, state, solution, believed, views, shape)


def _fitted(
    problem: _Intrinsics,
    state: State,
    solution: Solution,
    belief: Belief,
    views: Sequence[View],
    shape: Shape,
) -> Fit:
    residual = problem.residual(state)
    kept, w = np.concatenate(belief.inliers), np.concatenate(belief.weights)
    dof = 2 * kept.sum() - state.parameters.size - 6 * sum(m.any() for m in belief.inliers)
    # A prior holds a free board, about a fifth of whose numbers are really free of the data.
    dof -= 0.8 * state.shape.size if shape == "free" else state.shape.size
    if dof < 10:
        raise CalibrationError(
            f"{kept.sum()} usable corners in {len(views)} pictures are too few; take more pictures"
        )
    variance = float(((residual * w[:, None]) ** 2).sum() / dof)
    return Fit(
        state=state,
        board_shape=shape,
        views=tuple(views),
        inliers=belief.inliers,
        scales=belief.scales,
        residuals=tuple(_by_view(-residual, views)),
        sigma=float(np.sqrt(variance)),
        covariance=variance * inverse_information(solution.information),
        converged=solution.converged,
    )


def _doubt(residual: Float, views: Sequence[View]) -> list[Float]:
    """Square roots of Cauchy weights; noise is judged view by view."""
    distance = np.linalg.norm(residual, axis=1)
    usual = max(_robust_sigma(distance), 0.02)
    result = []
    for d in _by_view(distance, views):
        c = CAUCHY * usual * _scale(d, usual)
        result.append(1.0 / np.sqrt(1.0 + (d / c) ** 2) / _scale(d, usual))
    return result


def _judge(residual: Float, views: Sequence[View], before: Belief) -> Belief:
    """Corners within a few sigma of their view's noise, and that noise."""
    distance = np.linalg.norm(residual, axis=1)
    usual = max(_robust_sigma(distance), 0.01)
    inliers, scales = [], []
    for d, m in zip(_by_view(distance, views), before.inliers, strict=True):
        scale = _scale(d[m] if m.any() else d, usual)
        good = d <= REJECT_SIGMA * usual * scale
        inliers.append(good & (good.mean() >= MIN_KEPT if len(good) else False))
        scales.append(scale)
    return Belief(tuple(inliers), np.array(scales))


def _scale(distance: Float, usual: float) -> float:
    """Noise of one view over the usual, drawn towards 1 where a view has few corners."""
    if len(distance) == 0:
        return 1.0
    ratio = _robust_sigma(distance) / usual
    n = len(distance)
    return float(np.clip(np.sqrt((n * ratio**2 + SHRINK) / (n + SHRINK)), *SCALES))


def _by_view(values: Float, views: Sequence[View]) -> list[Float]:
    return np.split(values, np.cumsum([len(v.ids) for v in views])[:-1])


def first_guess(views: Sequence[View], board: Board) -> State:
    """Start values from OpenCV, gross errors removed view by view with homographies.

    Raises:
        CalibrationError: OpenCV finds none.
    """
    size = views[0].size
    points = board.points
    clean = [v.keep(_plausible(v, points)) for v in views]
    usable = [v if len(v.ids) >= 6 else w for v, w in zip(clean, views, strict=True)]
    try:
        _, K, distortion, turns, shifts = cv2.calibrateCamera(
            objectPoints=[points[v.ids].astype(np.float32) for v in usable],
            imagePoints=[v.pixels.astype(np.float32) for v in usable],
            imageSize=size,
            cameraMatrix=None,
            distCoeffs=None,
            flags=cv2.CALIB_FIX_K3,
        )
    except cv2.error as error:
        raise CalibrationError(
            f"no start value for {len(views)} pictures ({error.err}); tilt the board more"
        ) from error
    T = np.tile(np.eye(4), (len(views), 1, 1))
    for n, (turn, shift) in enumerate(zip(turns, shifts, strict=True)):
        T[n, :3, :3] = cv2.Rodrigues(src=turn)[0]
        T[n, :3, 3] = np.ravel(shift)
    return State(
        vector(np.asarray(K, float), np.asarray(distortion, float).ravel()[:4]), np.zeros(0), T
    )


def real_points(result: Fit, board: Board) -> Float:
    """(P, 3) of the board as the fit found it."""
    return deformed(board, shape_basis(board, result.board_shape), result.state.shape)


def _plausible(view: View, points: Float) -> NDArray[np.bool_]:
    """Corners that a homography explains to a few percent of the board's size in the picture."""
    H, _ = cv2.findHomography(
        srcPoints=points[view.ids, :2], dstPoints=view.pixels, method=cv2.LMEDS
    )
    if H is None:
        return np.ones(len(view.ids), bool)
    mapped = np.concatenate([points[view.ids, :2], np.ones((len(view.ids), 1))], axis=1) @ H.T
    error = np.linalg.norm(mapped[:, :2] / mapped[:, 2:] - view.pixels, axis=1)
    extent = float(np.linalg.norm(np.ptp(view.pixels, axis=0)))
    return np.asarray(error < max(5.0, 0.03 * extent, 6.0 * float(np.median(error))))


def _robust_sigma(distance: Float) -> float:
    """Noise of one coordinate from (M,) distances: their median is 1.1774 sigma (Rayleigh)."""
    return float(np.median(distance)) / 1.17741


def _resized(start: State, model: int, shape: int) -> State:
    parameters = np.zeros(4 + model)
    n = min(parameters.size, start.parameters.size)
    parameters[:n] = start.parameters[:n]
    numbers = start.shape if start.shape.size == shape else np.zeros(shape)
    return State(parameters, numbers, np.array(start.T_camera_board))
