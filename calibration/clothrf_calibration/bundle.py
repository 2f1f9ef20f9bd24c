"""Least squares over a few shared numbers and a small block of numbers for every view.

Gauss-Newton with Levenberg-Marquardt damping; the blocks of the views are eliminated by the Schur
complement (Triggs et al. 2000, "Bundle adjustment - a modern synthesis", section 6), so that the
cost grows linearly with the number of views. Both the intrinsics and the hand-eye problem are of
this form.
"""

from __future__ import annotations

from abc import abstractmethod
from collections.abc import Sequence
from dataclasses import dataclass
from typing import Protocol, TypeVar

import numpy as np

from clothrf_core.types import Float

StateT = TypeVar("StateT")


@dataclass(frozen=True, slots=True, eq=False)
class Block:
    """One view, linearised.

    Attributes:
        residual: (m,) weighted residuals.
        shared: (m, S) derivatives by the shared numbers.
        own: (m, V) derivatives by the view's own numbers.
    """

    residual: Float
    shared: Float
    own: Float


class Problem(Protocol[StateT]):
    """What `solve` minimises: the sum of squares of all residuals."""

    @abstractmethod
    def blocks(self, state: StateT) -> Sequence[Block]:
        """Every view, linearised at `state`."""

    @abstractmethod
    def prior(self, state: StateT) -> tuple[Float, Float] | None:
        """(p,) residuals and (p, S) derivatives that concern the shared numbers only."""

    @abstractmethod
    def cost(self, state: StateT) -> float:
        """Sum of squares of all residuals, priors included."""

    @abstractmethod
    def moved(self, state: StateT, shared: Float, own: Sequence[Float]) -> StateT:
        """`state` after a step."""


@dataclass(frozen=True, slots=True, eq=False)
class Solution:
    """A minimum.

    Attributes:
        information: (S, S) Schur complement: inverse covariance of the shared numbers for unit
            residuals, the views' own numbers marginalised.
        iterations: steps taken.
        converged: the last step was small enough.
    """

    information: Float
    iterations: int
    converged: bool


def solve(
    problem: Problem[StateT], state: StateT, *, iterations: int = 60, tolerance: float = 1e-10
) -> tuple[StateT, Solution]:
    """The nearest minimum, from `state`."""
    damping, cost = 1e-4, problem.cost(state)
    for n in range(iterations):
        normal = _normal(problem, state)
        while True:
            shared, own = _step(normal, damping)
            trial = problem.moved(state, shared, own)
            new = problem.cost(trial)
            if np.isfinite(new) and new <= cost:
                break
            damping = max(damping * 10.0, 1e-8)
            if damping > 1e8:
                return state, Solution(_schur(normal, 0.0)[0], n, converged=True)
        gain = (cost - new) / max(cost, 1e-300)
        state, cost, damping = trial, new, max(damping * 0.1, 1e-12)
        if gain < tolerance:
            return state, Solution(_schur(_normal(problem, state), 0.0)[0], n + 1, converged=True)
    return state, Solution(_schur(_normal(problem, state), 0.0)[0], iterations, converged=False)


@dataclass(frozen=True, slots=True, eq=False)
class _Normal:
    ss: Float
    s: Float
    vv: list[Float]
    vs: list[Float]
    v: list[Float]


def _normal(problem: Problem[StateT], state: StateT) -> _Normal:
    blocks = problem.blocks(state)
    size = blocks[0].shared.shape[1]
    ss, s = np.zeros((size, size)), np.zeros(size)
    vv, vs, v = [], [], []
    for block in blocks:
        ss += block.shared.T @ block.shared
        s += block.shared.T @ block.residual
        vv.append(block.own.T @ block.own)
        vs.append(block.own.T @ block.shared)
        v.append(block.own.T @ block.residual)
    prior = problem.prior(state)
    if prior is not None:
        residual, J = prior
        ss += J.T @ J
        s += J.T @ residual
    return _Normal(ss, s, vv, vs, v)


def _schur(normal: _Normal, damping: float) -> tuple[Float, Float, list[Float], list[Float]]:
    """Reduced matrix and right side, and for every view its solved own-by-shared and own parts."""
    S, b = normal.ss.copy(), normal.s.copy()
    S[np.diag_indices_from(S)] += damping * (np.diag(normal.ss) + 1e-12)
    gains, offsets = [], []
    for vv, vs, v in zip(normal.vv, normal.vs, normal.v, strict=True):
        if not vv.any():
            gains.append(np.zeros_like(vs))
            offsets.append(np.zeros(len(v)))
            continue
        diagonal = np.diag(vv)
        damped = vv + np.diag(damping * (diagonal + 1e-12))
        scale = 1.0 / np.sqrt(diagonal * (1.0 + damping) + 1e-300)
        inverse = _inverse(scale[:, None] * damped * scale) * np.outer(scale, scale)
        gain, offset = inverse @ vs, inverse @ v
        S -= vs.T @ gain
        b -= vs.T @ offset
        gains.append(gain)
        offsets.append(offset)
    return 0.5 * (S + S.T), b, gains, offsets


def _step(normal: _Normal, damping: float) -> tuple[Float, list[Float]]:
    S, b, gains, offsets = _schur(normal, damping)
    shared = -(inverse_information(S) @ b) if S.size else np.zeros(0)
    return shared, [-o - g @ shared for g, o in zip(gains, offsets, strict=True)]


def _inverse(A: Float) -> Float:
    try:
        return np.asarray(np.linalg.inv(A))
    except np.linalg.LinAlgError:
        return np.asarray(np.linalg.pinv(A))


def inverse_information(S: Float) -> Float:
    """Inverse of a symmetric positive matrix, scaled first; what is undetermined gets 1e12."""
    diagonal = np.sqrt(np.maximum(np.diag(S), 1e-300))
    values, vectors = np.linalg.eigh(S / np.outer(diagonal, diagonal))
    safe = np.maximum(values, 1e-14)
    inverse: Float = (vectors / safe) @ vectors.T / np.outer(diagonal, diagonal)
    return inverse
