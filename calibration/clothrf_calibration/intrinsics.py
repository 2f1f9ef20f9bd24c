"""From views of a board to intrinsics that say how good they are."""

from __future__ import annotations

import dataclasses
from collections.abc import Callable, Sequence
from dataclasses import dataclass, field

import numpy as np
from numpy.typing import NDArray

from clothrf_calibration.boards import Board
from clothrf_calibration.boardshape import SHAPES, Shape, deviation, shape_basis
from clothrf_calibration.coverage import ENOUGH, TILT_SPREAD, Coverage, advice, coverage
from clothrf_calibration.crossvalidation import (
    FOLDS,
    HeldOut,
    cross_validate,
    simplest,
)
from clothrf_calibration.errors import CalibrationError, DegenerateData
from clothrf_calibration.intrinsics_fit import Fit, fit
from clothrf_calibration.threads import one_thread
from clothrf_calibration.uncertainty import (
    UncertaintyMap,
    uncertainty_map,
    uncertainty_warnings,
)
from clothrf_calibration.views import View, one_size
from clothrf_core.types import Float

MIN_VIEWS, GOOD_VIEWS, SELECTION_VIEWS = 3, 10, 6
MIN_SPREAD = 5.0
# A freely shaped board can trade with the principal point: it must win clearly to be believed.
FREE_MARGIN = 0.4
WORTH_TRYING = 0.85
# Share of the held-out error by which anything richer must win.
MARGIN = 0.01
# k3 is left to its prior rather than to a choice: four coefficients only where asked for.
TRIED = (0, 5, 8)
MAX_FOCAL_SD = 0.1


@dataclass(frozen=True, slots=True)
class Options:
    """What may be decided by hand.

    Attributes:
        model: distortion coefficients (0, 4, 5, 8), or None to let held-out views decide.
        shape: deviation of the board, or None to let held-out views decide.
        folds: parts of the cross-validation.
    """

    model: int | None = None
    shape: Shape | None = None
    folds: int = FOLDS


@dataclass(frozen=True, slots=True, eq=False)
class Calibration:
    """Intrinsics and all that is known about their quality.

    Attributes:
        board: the board as drawn.
        fit: the final fit.
        held_out: errors of views that did not take part, of the chosen model.
        models: coefficients -> held-out error, pixels, of every model tried.
        shapes: board shape -> held-out error, pixels, of every shape tried.
        coverage: what the views cover.
        uncertainty: of projections at infinity.
        near_uncertainty: of projections at the median distance of the board.
        dropped: view -> why it was not used.
        warnings: what the user should know, one line each.
    """

    board: Board
    fit: Fit
    held_out: HeldOut | None
    models: dict[int, float]
    shapes: dict[str, float]
    coverage: Coverage
    uncertainty: UncertaintyMap
    near_uncertainty: UncertaintyMap
    dropped: dict[str, str] = field(default_factory=dict)
    warnings: tuple[str, ...] = ()

    @property
    def parameters(self) -> Float:
        """(4 + D,) intrinsic vector."""
        return self.fit.state.parameters

    @property
    def covariance(self) -> Float:
        """(4 + D, 4 + D) of `parameters`."""
        n = self.parameters.size
        return self.fit.covariance[:n, :n]

    @property
    def uncertain(self) -> list[str]:
        """Those warnings that later measurements may overcome."""
        return uncertainty_warnings(self.parameters, self.covariance, self.uncertainty)

    @property
    def used(self) -> NDArray[np.bool_]:
        """(V,) views that took part."""
        return np.array([bool(m.any()) for m in self.fit.inliers])


def calibrate(
    views: Sequence[View],
    board: Board,
    options: Options | None = None,
    *,
    step: Callable[[str, int, int], None] | None = None,
) -> Calibration:
    """Solve for intrinsics; choose board shape and lens model by held-out views.

    Args:
        views: of one camera at one resolution.
        board: the board as drawn.
        options: what is decided by hand.
        step: called with (what, done, of) as the work goes on.

    Raises:
        CalibrationError: too few views, mixed resolutions.
        DegenerateData: all views alike.
    """
    with one_thread():
        return _calibrate(views, board, options or Options(), step)


def _calibrate(
    views: Sequence[View],
    board: Board,
    options: Options,
    step: Callable[[str, int, int], None] | None,
) -> Calibration:
    one_size(views)
    if len(views) < MIN_VIEWS:
        raise CalibrationError(
            f"expected at least {MIN_VIEWS} pictures with the board, found {len(views)}; take 15 "
            "or more, tilted in different directions"
        )
    steps = _Steps(step, options)
    first = fit(views, board, model=options.model if options.model is not None else 5,
                shape=options.shape or "flat")  # fmt: skip
    _refuse_alike(first, board)
    selecting = int(sum(m.any() for m in first.inliers)) >= SELECTION_VIEWS
    k = options.folds
    shape, shapes = _choose_shape(first, board, options, selecting=selecting, k=k, steps=steps)
    if first.board_shape != shape:
        first = fit(views, board, model=5, shape=shape, start=first.state)
    model, models, held = _choose_model(
        first, board, options, shape, selecting=selecting, k=k, steps=steps
    )
    final = fit(views, board, model=model, shape=shape, start=first.state)
    final = dataclasses.replace(
        final, covariance=final.covariance * max(1.0, correlation(final)) ** 2
    )
    steps.next("final fit")
    seen = coverage(final.views, final.state.T_camera_board, board.points)
    far = uncertainty_map(final, board)
    near = uncertainty_map(final, board, range_m=float(np.median(seen.distances)))
    dropped = {
        v.name: "its corners do not fit the others (wrong board, moved or blurred picture)"
        for v, m in zip(final.views, final.inliers, strict=True)
        if not m.any()
    }
    result = Calibration(board, final, held, models, shapes, seen, far, near, dropped=dropped)
    return Calibration(
        board, final, held, models, shapes, seen, far, near, dropped, tuple(_warnings(result))
    )


class _Steps:
    """Counts the work for a progress bar."""

    def __init__(self, step: Callable[[str, int, int], None] | None, options: Options) -> None:
        tried = (len(SHAPES) if options.shape is None else 0) + (
            len(TRIED) if options.model is None else 1
        )
        self._step, self._done, self._of = step, 0, tried * options.folds + 1

    def of(self, what: str) -> Callable[[], None]:
        return lambda: self.next(what)

    def next(self, what: str) -> None:
        self._done += 1
        if self._step is not None:
            self._step(what, min(self._done, self._of), self._of)


def _choose_shape(
    first: Fit, board: Board, options: Options, *, selecting: bool, k: int, steps: _Steps
) -> tuple[Shape, dict[str, float]]:
    if options.shape is not None:
        return options.shape, {}
    if not selecting:
        return "flat", {}
    shapes: list[Shape] = ["flat", "warp"]
    warp, free = (
        fit(first.views, board, model=5, shape=s, start=first.state, belief=first.belief)
        for s in ("warp", "free")
    )
    if free.sigma < WORTH_TRYING * warp.sigma:
        shapes.append("free")
    tried = [
        cross_validate(first, board, model=5, shape=s, k=k, step=steps.of(f"{s} board"))
        for s in shapes
    ]
    chosen = simplest(tried[:2], margin=MARGIN)
    if len(tried) > 2 and simplest([tried[chosen], tried[2]], margin=FREE_MARGIN) == 1:
        chosen = 2
    return shapes[chosen], {s: t.total for s, t in zip(shapes, tried, strict=True)}


def _choose_model(
    first: Fit,
    board: Board,
    options: Options,
    shape: Shape,
    *,
    selecting: bool,
    k: int,
    steps: _Steps,
) -> tuple[int, dict[int, float], HeldOut | None]:
    candidates = TRIED if options.model is None else (options.model,)
    if not selecting:
        return options.model if options.model is not None else 5, {}, None
    tried = [
        cross_validate(
            first,
            board,
            model=m,
            shape=shape,
            k=k,
            step=steps.of(f"{m} distortion coefficients"),
        )
        for m in candidates
    ]
    best = simplest(tried, margin=MARGIN)
    return (
        candidates[best],
        {m: t.total for m, t in zip(candidates, tried, strict=True)},
        tried[best],
    )


def _refuse_alike(first: Fit, board: Board) -> None:
    seen = coverage(first.views, first.state.T_camera_board, board.points)
    relative = float(np.sqrt(first.covariance[0, 0])) / abs(float(first.state.parameters[0]))
    if seen.spread < MIN_SPREAD or relative > MAX_FOCAL_SD:
        raise DegenerateData(
            f"all {len(first.views)} pictures are alike: the board's normals differ by "
            f"{seen.spread:.0f} degrees at most and the focal length is uncertain by "
            f"{100 * relative:.0f} %; tilt the board by 20 to 45 degrees in different directions"
        )


def _warnings(c: Calibration) -> list[str]:
    """What the data cannot support, and what to do."""
    say = []
    used = int(c.used.sum())
    if used < GOOD_VIEWS:
        say.append(f"only {used} pictures took part; 15 or more give trustworthy numbers")
    if c.coverage.spread < TILT_SPREAD:
        say.append(
            f"the board's normals differ by {c.coverage.spread:.0f} degrees at most; the focal "
            "length is weak, tilt the board by 20 to 45 degrees"
        )
    if c.coverage.share < ENOUGH:
        empty = int((c.coverage.cells == 0).sum())
        say.append(
            f"{empty} of {c.coverage.cells.size} cells of the picture hold no corner; "
            + next((a for a in advice(c.coverage) if a.startswith("bring")), "cover them")
        )
    say += c.uncertain
    rejected = c.fit.rejected / max(sum(len(v.ids) for v in c.fit.views), 1)
    if rejected > 0.05:
        say.append(f"{100 * rejected:.0f} % of the corners were rejected; look for blur and glare")
    if c.fit.rms > 1.0:
        say.append(
            f"the residual of {c.fit.rms:.2f} px is large; is the board flat and the size right?"
        )
    say += _shape_warnings(c)
    ratio = correlation(c.fit)
    if ratio > 1.5:
        say.append(
            f"residuals of neighbouring corners go the same way (errors are {ratio:.1f} times as "
            "wide as noise alone, which the stated uncertainty contains): the print is not exact "
            "or the lens model does not fit; look at the residual pictures"
        )
    if not c.fit.converged:
        say.append("the solver did not converge; the model may have too many coefficients")
    return say


def _shape_warnings(c: Calibration) -> list[str]:
    say = []
    if c.fit.board_shape != "flat":
        out, plane = deviation(c.board, shape_basis(c.board, c.fit.board_shape), c.fit.state.shape)
        if out > 5e-4 or plane > 2e-4:
            say.append(
                f"the board is bent by {out * 1e3:.2f} mm and {plane * 1e3:.2f} mm off in its "
                "plane; a stiff board would be better"
            )
    free, taken = c.shapes.get("free"), c.shapes.get(c.fit.board_shape)
    if (
        free is not None
        and taken is not None
        and c.fit.board_shape != "free"
        and (free < 0.85 * taken)
    ):
        say.append(
            f"solving for every point of the board would lower the held-out error from "
            f"{taken:.3f} to {free:.3f} px: the print is not exact; use a better board, or "
            "--shape free with views turned by 90 degrees"
        )
    return say


def correlation(result: Fit) -> float:
    """How much wider errors are than independent noise of the same size would make them.

    Neighbouring corners share systematic errors (an inexact print, a wrong lens model): with
    correlation r of neighbours, a mean scatters sqrt((1 + 2 r) / (1 - r)) times as much as if they
    were independent. 1 for pure noise; the stated covariance is widened by its square.
    """
    kept = [
        r[m] / (result.sigma * s)
        for r, m, s in zip(result.residuals, result.inliers, result.scales, strict=True)
        if m.sum() >= 8
    ]
    if len(kept) < 3:
        return 1.0
    every = np.concatenate(kept)
    together = np.concatenate([r[1:] * r[:-1] for r in kept]).mean() / (every**2).mean()
    return float(np.sqrt(max(1.0 + 2.0 * together, 0.0) / max(1.0 - together, 0.1)))
