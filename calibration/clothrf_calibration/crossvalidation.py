"""How well numbers fitted to some views predict others: what a residual of the fit cannot tell."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from clothrf_calibration.boardpose import fit_pose
from clothrf_calibration.boards import Board
from clothrf_calibration.boardshape import Shape
from clothrf_calibration.intrinsics_fit import Belief, Fit, State, fit, real_points
from clothrf_calibration.views import View
from clothrf_core.types import Float

FOLDS = 5
MIN_TRAIN = 4


@dataclass(frozen=True, slots=True, eq=False)
class HeldOut:
    """Errors on views that were not used.

    Attributes:
        rms: (V,) root mean square distance of each view's corners, pixels, its pose refitted.
    """

    rms: Float

    @property
    def total(self) -> float:
        """Root mean square over the views, pixels."""
        return float(np.sqrt((self.rms**2).mean()))

    @property
    def spread(self) -> float:
        """Standard deviation from view to view, pixels."""
        return float(self.rms.std(ddof=1))


def folds(count: int, k: int, *, seed: int = 0) -> list[NDArray[np.int64]]:
    """`k` sets of held-out indices of `count` views."""
    order = np.random.default_rng(seed).permutation(count)
    return [np.sort(order[i::k]) for i in range(min(k, count))]


def cross_validate(
    full: Fit,
    board: Board,
    *,
    model: int,
    shape: Shape,
    k: int = FOLDS,
    step: Callable[[], None] | None = None,
) -> HeldOut:
    """Errors of each view under a fit of `model` and `shape` to the other folds.

    The corners that `full` rejected are rejected everywhere, so that candidates are compared on
    the same corners.
    """
    used = [i for i, m in enumerate(full.inliers) if m.any()]
    views = [full.views[i] for i in used]
    masks = [full.inliers[i] for i in used]
    poses, scales = full.state.T_camera_board[used], full.scales[used]
    rms = np.zeros(len(used))
    for held in folds(len(used), k):
        train = [i for i in range(len(used)) if i not in held]
        start = State(full.state.parameters, np.zeros(0), poses[train])
        result = fit(
            [views[i] for i in train],
            board,
            model=model,
            shape=shape,
            start=start,
            belief=Belief(tuple(masks[i] for i in train), scales[train]),
        )
        points = real_points(result, board)
        for i in held:
            rms[i] = view_error(result.state.parameters, points, views[i], mask=masks[i])
        if step is not None:
            step()
    return HeldOut(rms)


def view_error(
    parameters: Float, points: Float, view: View, *, mask: NDArray[np.bool_] | None = None
) -> float:
    """Root mean square distance of a view's believed corners, pixels, its pose refitted."""
    _, residual = fit_pose(parameters, points, view, mask=mask)
    kept = residual if mask is None else residual[mask]
    return float(np.sqrt((kept**2).sum(axis=1).mean()))


def simplest(candidates: Sequence[HeldOut], *, margin: float = 0.0) -> int:
    """Index of the first candidate that no later one beats by more than one standard error.

    Candidates go from simple to rich; differences are paired view by view (Hastie et al. 2009,
    section 7.10, the one-standard-error rule). A richer one must also win by the share `margin`.
    """
    chosen = 0
    for n in range(1, len(candidates)):
        gain = candidates[chosen].rms ** 2 - candidates[n].rms ** 2
        error = gain.std(ddof=1) / np.sqrt(len(gain))
        better = candidates[n].total < (1.0 - margin) * candidates[chosen].total
        if gain.mean() > error and better:
            chosen = n
    return chosen
