"""Joint refinement of camera and board pose, and more if wanted, on reprojection errors.

A board corner b of view i is seen at ``project(Y A_i E_i Z s b)`` with Y = inv(X), or, with the
camera on the hand, at ``project(Y E_i A_i Z s b)``: E_i is a small correction of the robot's pose
in the gripper's frame (with a prior as wide as the robot is inexact), s a scale of the board that
is 1 unless it is tested. See `handeye_start` for X, Z, A.
"""

from __future__ import annotations

import dataclasses
from collections.abc import Sequence
from typing import Literal

import numpy as np
from typing_extensions import override

from clothrf_calibration import rigid
from clothrf_calibration.bundle import Block, Problem, inverse_information, solve
from clothrf_calibration.lens import project_jacobian
from clothrf_calibration.views import View
from clothrf_core.types import Float

Setup = Literal["fixed", "hand"]


@dataclasses.dataclass(frozen=True, slots=True, eq=False)
class RobotNoise:
    """How inexact the reported robot poses are, one standard deviation of each coordinate.

    Attributes:
        turn: radians.
        shift: metres.
    """

    turn: float = 0.0
    shift: float = 0.0

    @property
    def any(self) -> bool:
        """Not a perfect robot."""
        return self.turn > 0.0 or self.shift > 0.0


@dataclasses.dataclass(frozen=True, slots=True, eq=False)
class HandEyeState:
    """Everything that is solved for.

    Attributes:
        Y: (4, 4) inverse of X.
        Z: (4, 4) pose of the board.
        scale: of the board.
        parameters: intrinsic vector.
        E: (V, 4, 4) corrections of the robot poses.
    """

    Y: Float
    Z: Float
    scale: float
    parameters: Float
    E: Float


@dataclasses.dataclass(frozen=True, slots=True, eq=False)
class HandEyeProblem(Problem[HandEyeState]):
    """The data and what is free.

    Attributes:
        setup: fixed or hand.
        A: (V, 4, 4) robot poses as `handeye_start` defines them.
        views: corners, outliers removed.
        points: (P, 3) of the board as it is.
        sigma: noise of one coordinate of a corner, pixels.
        noise: of the robot; none = its poses are exact.
        intrinsics: (4 + D,) prior of the intrinsics.
        covariance: of that prior; None = they are exact.
        free_scale: solve for the board's scale.
    """

    setup: Setup
    A: Float
    views: Sequence[View]
    points: Float
    sigma: float
    intrinsics: Float
    noise: RobotNoise = dataclasses.field(default_factory=RobotNoise)
    covariance: Float | None = None
    free_scale: bool = False

    @property
    def columns(self) -> tuple[slice, slice, slice, slice]:
        """Where Y, Z, the scale and the intrinsics stand among the shared numbers."""
        n = 12 + int(self.free_scale)
        k = 0 if self.covariance is None else self.intrinsics.size
        return slice(0, 6), slice(6, 12), slice(12, n), slice(n, n + k)

    def residual(self, state: HandEyeState) -> Float:
        """(M, 2) projected minus measured, pixels."""
        return self._linear(state, derivatives=False)[0]

    def _linear(
        self, state: HandEyeState, *, derivatives: bool
    ) -> tuple[Float, Float, Float, list[int]]:
        counts = [len(v.ids) for v in self.views]
        view = np.repeat(np.arange(len(self.views)), counts)
        b = self.points[np.concatenate([v.ids for v in self.views])]
        by_scale = b @ state.Z[:3, :3].T
        turned_z = state.scale * by_scale
        q1 = turned_z + state.Z[:3, 3]
        A, E = self.A[view], state.E[view]
        first, second = (E, A) if self.setup == "fixed" else (A, E)
        q2 = _apply(first, q1)
        q3 = _apply(second, q2)
        turned_y = q3 @ state.Y[:3, :3].T
        local = turned_y + state.Y[:3, 3]
        behind = local[:, 2] < 1e-3
        local[behind, 2] = 1e-3
        pixels, by_point, by_parameter = project_jacobian(state.parameters, local)
        measured = np.concatenate([v.pixels for v in self.views])
        residual = np.where(behind[:, None], 1e4, pixels - measured)
        if not derivatives:
            return residual, by_point, by_point, counts
        R_Y = by_point @ state.Y[:3, :3]
        chain_z = R_Y @ second[:, :3, :3] @ first[:, :3, :3]
        parts = [-by_point @ rigid.skew(turned_y), by_point]
        parts += [-chain_z @ rigid.skew(turned_z), chain_z]
        if self.free_scale:
            parts.append(chain_z @ by_scale[:, :, None])
        if self.covariance is not None:
            parts.append(by_parameter)
        shared = np.concatenate(parts, axis=2)
        if self.setup == "fixed":
            chain, moved = R_Y @ A[:, :3, :3], _turn(E, q1)
        else:
            chain, moved = R_Y, _turn(E, q2)
        own = np.concatenate([-chain @ rigid.skew(moved), chain], axis=2)
        return residual, shared, own, counts

    @override
    def blocks(self, state: HandEyeState) -> list[Block]:
        residual, shared, own, counts = self._linear(state, derivatives=True)
        cuts = np.cumsum(counts)[:-1]
        result = []
        for n, (r, s, o) in enumerate(
            zip(np.split(residual, cuts), np.split(shared, cuts), np.split(own, cuts), strict=True)
        ):
            r, s = r.ravel() / self.sigma, s.reshape(-1, s.shape[2]) / self.sigma
            if not self.noise.any:
                result.append(Block(r, s, np.zeros((len(r), 0))))
                continue
            o = o.reshape(-1, 6) / self.sigma
            e, J = self._correction(state.E[n])
            result.append(
                Block(
                    np.concatenate([r, e]),
                    np.concatenate([s, np.zeros((6, s.shape[1]))]),
                    np.concatenate([o, J]),
                )
            )
        return result

    def _correction(self, E: Float) -> tuple[Float, Float]:
        width = np.array([self.noise.turn] * 3 + [self.noise.shift] * 3)
        width = np.maximum(width, 1e-9)
        return np.concatenate([rigid.log(E[:3, :3]), E[:3, 3]]) / width, np.diag(1.0 / width)

    @override
    def prior(self, state: HandEyeState) -> tuple[Float, Float] | None:
        if self.covariance is None:
            return None
        L = np.linalg.cholesky(inverse_information(self.covariance)).T
        J = np.zeros((len(L), self.columns[3].stop))
        J[:, self.columns[3]] = L
        return L @ (state.parameters - self.intrinsics), J

    @override
    def cost(self, state: HandEyeState) -> float:
        total = float((self.residual(state) ** 2).sum()) / self.sigma**2
        if self.noise.any:
            total += sum(float((self._correction(E)[0] ** 2).sum()) for E in state.E)
        prior = self.prior(state)
        return total + (float(prior[0] @ prior[0]) if prior is not None else 0.0)

    @override
    def moved(self, state: HandEyeState, shared: Float, own: Sequence[Float]) -> HandEyeState:
        y, z, s, k = self.columns
        return HandEyeState(
            rigid.stepped(state.Y, shared[y]),
            rigid.stepped(state.Z, shared[z]),
            state.scale + float(shared[s].sum()),
            state.parameters + shared[k] if self.covariance is not None else state.parameters,
            rigid.stepped(state.E, np.stack(own)) if self.noise.any else state.E,
        )


@dataclasses.dataclass(frozen=True, slots=True, eq=False)
class HandEyeFit:
    """A minimum.

    Attributes:
        state: the numbers.
        covariance: (S, S) of the shared numbers (Y, Z, scale, intrinsics) for the stated noise.
        chi2: cost at the minimum; near its degrees of freedom if the noise is stated right.
        dof: degrees of freedom.
    """

    state: HandEyeState
    covariance: Float
    chi2: float
    dof: int

    @property
    def pose(self) -> Float:
        """(4, 4) T_base_camera (fixed) or T_gripper_camera (hand)."""
        return rigid.inverse(self.state.Y)

    @property
    def pose_covariance(self) -> Float:
        """(6, 6) covariance of X: small left turn (rad), then shift (m), X's outer axes."""
        return covariance_of_inverse(self.state.Y, self.covariance[:6, :6])


def refine(problem: HandEyeProblem, X: Float, Z: Float, *, E: Float | None = None) -> HandEyeFit:
    """The nearest minimum from X and Z."""
    state = HandEyeState(
        rigid.inverse(X),
        Z,
        1.0,
        problem.intrinsics,
        np.tile(np.eye(4), (len(problem.A), 1, 1)) if E is None else E,
    )
    state, solution = solve(problem, state, iterations=80, tolerance=1e-11)
    rows = 2 * sum(len(v.ids) for v in problem.views)
    dof = rows - 12 - int(problem.free_scale)
    return HandEyeFit(
        state, inverse_information(solution.information), problem.cost(state), max(dof, 1)
    )


def covariance_of_inverse(Y: Float, covariance: Float) -> Float:
    """(6, 6) left-step covariance of inv(Y) from that of Y."""
    R = Y[:3, :3].T
    L = np.zeros((6, 6))
    L[:3, :3] = -R
    L[3:, :3] = -R @ rigid.skew(Y[:3, 3])
    L[3:, 3:] = -R
    return L @ covariance @ L.T


def _apply(T: Float, points: Float) -> Float:
    return _turn(T, points) + T[:, :3, 3]


def _turn(T: Float, points: Float) -> Float:
    return np.asarray((T[:, :3, :3] @ points[:, :, None])[:, :, 0])
