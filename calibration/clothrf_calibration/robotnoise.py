"""Finds out from the data how inexact the robot's poses are (restricted maximum likelihood).

Guessing this number is worse than ignoring it: too large, and good poses are thrown away; too
small, and the stated uncertainty is a fiction. Every view gives one discrepancy e_i between the
board's pose as seen and as the robot says, with e_i = H_i b + n_i: b the error of the shared
numbers, n_i noise of the picture (known) and of the robot (wanted). The restricted likelihood
(Patterson and Thompson 1971) of the wanted widths is maximised.
"""

from __future__ import annotations

import dataclasses

import numpy as np
from scipy.optimize import minimize

from clothrf_calibration.handeye_fit import HandEyeFit, HandEyeProblem, RobotNoise, refine
from clothrf_core.types import Float

FLOOR = RobotNoise(turn=1e-7, shift=1e-7)
# Twice the gain in log-likelihood that two extra numbers must bring (5 %, half-bounded).
WORTH = 5.0


def estimate_noise(problem: HandEyeProblem, start: HandEyeFit) -> RobotNoise:
    """Widths of the robot's errors; none if the data do not show any."""
    data = _discrepancies(problem, start)

    def minus_twice(logs: Float) -> float:
        turn, shift = np.exp(np.clip(logs, np.log(1e-7), np.log(0.2)))
        return _minus_twice_likelihood(data, np.array([turn] * 3 + [shift] * 3) ** 2)

    best = minimize(
        minus_twice,
        np.log([1e-3, 1e-3]),
        method="Nelder-Mead",
        options={"xatol": 0.02, "fatol": 0.01, "maxiter": 200},
    )
    perfect = _minus_twice_likelihood(data, np.full(6, FLOOR.turn**2))
    if perfect - best.fun < WORTH:
        return RobotNoise()
    turn, shift = np.exp(np.clip(best.x, np.log(1e-7), np.log(0.2)))
    return RobotNoise(float(turn), float(shift))


def refine_with_noise(problem: HandEyeProblem, X: Float, Z: Float) -> tuple[HandEyeFit, RobotNoise]:
    """Joint refinement with the robot's inexactness estimated from the same data."""
    exact = dataclasses.replace(problem, noise=RobotNoise())
    result = refine(exact, X, Z)
    noise = RobotNoise()
    for _ in range(3):
        noise = estimate_noise(problem, result)
        if not noise.any:
            return refine(exact, result.pose, result.state.Z), noise
        result = refine(dataclasses.replace(problem, noise=noise), result.pose, result.state.Z)
    return result, noise


@dataclasses.dataclass(frozen=True, slots=True, eq=False)
class _Data:
    e: Float
    H: Float
    P: Float
    prior: Float


def _discrepancies(problem: HandEyeProblem, fit: HandEyeFit) -> _Data:
    """Pose discrepancy, its derivatives and its covariance from the picture, for each view."""
    wide = dataclasses.replace(problem, noise=RobotNoise(1e6, 1e6))
    state = dataclasses.replace(fit.state, E=np.tile(np.eye(4), (len(problem.A), 1, 1)))
    e, H, P = [], [], []
    for block in wide.blocks(state):
        information = block.own.T @ block.own
        inverse = np.linalg.pinv(information)
        e.append(-inverse @ block.own.T @ block.residual)
        H.append(-inverse @ block.own.T @ block.shared)
        P.append(inverse)
    prior = problem.prior(state)
    n = H[0].shape[1]
    information = np.zeros((n, n)) if prior is None else prior[1].T @ prior[1]
    return _Data(np.stack(e), np.stack(H), np.stack(P), information)


def _minus_twice_likelihood(data: _Data, variance: Float) -> float:
    V = data.P + np.diag(variance)
    L = np.linalg.cholesky(V)
    e = np.linalg.solve(L, data.e[:, :, None])[:, :, 0]
    H = np.linalg.solve(L, data.H)
    N = np.einsum("vij,vik->jk", H, H) + data.prior
    scale = 1.0 / np.sqrt(np.maximum(np.diag(N), 1e-300))
    N = N * np.outer(scale, scale) + 1e-12 * np.eye(len(N))
    right = scale * np.einsum("vij,vi->j", H, e)
    b = np.linalg.solve(N, right)
    logs = 2.0 * np.log(np.einsum("vii->vi", L)).sum() + np.linalg.slogdet(N)[1]
    logs -= 2.0 * np.log(scale).sum()
    return float(logs + (e**2).sum() - right @ b)
