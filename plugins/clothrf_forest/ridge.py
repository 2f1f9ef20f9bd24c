"""The linear base: one ridge regression on standardised features, chosen and scored by roll-outs.

Its strength is the one with the least error on held-out roll-outs, and the residuals that the
trees learn are those of models that did not see the row's roll-out: residuals of the final model
on its own rows would be too small to learn from.

Everything is computed from moments per fold, read in chunks: memory does not grow with rows.
"""

from __future__ import annotations

import functools
import operator
from collections.abc import Callable, Sequence
from dataclasses import dataclass
from typing import Protocol

import numpy as np
from numpy.typing import NDArray
from scipy.linalg import cho_factor, cho_solve

from clothrf_core.types import Float, Float32
from clothrf_forest.binning import chunks
from clothrf_forest.rows import Rows

FOLDS = 6
# Standard deviations at which a feature is clipped: a few wild values (a corner sought in a
# scrap of cloth) tilt every direction. Measured: 10.4 instead of 11.8 mm, three tasks, SR300 noise.
LIMIT = 5.0
STRENGTHS = tuple(10.0**e for e in (-4.0, -3.5, -3.0, -2.5, -2.0, -1.5, -1.0, -0.5, 0.0, 0.5))


@dataclass(frozen=True, slots=True)
class Moments:
    """Sums over some rows, of features shifted and scaled: enough for any linear model.

    Attributes:
        n: rows, or the sum of how much they count.
        x: (F,) sum of features.
        y: (D,) sum of targets.
        xx: (F, F) sum of products of features.
        xy: (F, D) sum of products of features and targets.
        yy: (D,) sum of squared targets.
    """

    n: float
    x: Float
    y: Float
    xx: Float
    xy: Float
    yy: Float

    def __add__(self, other: Moments) -> Moments:
        return self._with(other, 1)

    def __sub__(self, other: Moments) -> Moments:
        return self._with(other, -1)

    def _with(self, other: Moments, sign: int) -> Moments:
        return Moments(
            n=self.n + sign * other.n,
            x=self.x + sign * other.x,
            y=self.y + sign * other.y,
            xx=self.xx + sign * other.xx,
            xy=self.xy + sign * other.xy,
            yy=self.yy + sign * other.yy,
        )

    def covariance(self) -> Float:
        """(F, F) covariance of the features."""
        mean = self.x / self.n
        return self.xx / self.n - np.outer(mean, mean)


@dataclass(frozen=True, slots=True)
class Linear:
    """y = (x - centre) * scale @ coef + intercept.

    Attributes:
        coef: (F, D) float64.
        intercept: (D,) float64.
    """

    coef: Float
    intercept: Float


@dataclass(frozen=True, slots=True)
class Scaling:
    """Standardisation of features.

    Attributes:
        centre: (F,) float32 mean.
        scale: (F,) float32 inverse standard deviation; 0 for a constant feature.
    """

    centre: Float32
    scale: Float32

    def of(self, values: Float32 | Float, limit: float = LIMIT) -> Float:
        """(n, F) float64 standardised rows, clipped at +-`limit`."""
        z = (values - self.centre) * self.scale
        return np.clip(z, -limit, limit, out=z).astype(np.float64, copy=False)


Index = slice | NDArray[np.int64]


class Design(Protocol):
    """(N, F) standardised numbers, read a part at a time."""

    def __len__(self) -> int: ...

    @property
    def width(self) -> int:
        """F."""

    def of(self, rows: Index) -> Float:
        """(n, F) float64."""


@dataclass(frozen=True, slots=True)
class Straight(Design):
    """The features themselves, standardised.

    Attributes:
        rows: the features.
        by: how they are standardised.
    """

    rows: Rows
    by: Scaling

    def __len__(self) -> int:
        return len(self.rows)

    @property
    def width(self) -> int:
        """F."""
        return self.rows.width

    def of(self, rows: Index) -> Float:
        """(n, F) float64."""
        return self.by.of(self.rows[rows])


def spread(read: Callable[[slice], Float32 | Float], n: int, width: int) -> Scaling:
    """Mean and standard deviation of `n` rows of `width` columns, read in chunks."""
    total = np.zeros(width)
    for rows in chunks(n):
        total += read(rows).astype(np.float64).sum(0)
    mean = total / n
    square = np.zeros(width)
    for rows in chunks(n):
        square += ((read(rows).astype(np.float64) - mean) ** 2).sum(0)
    std = np.sqrt(square / n)
    known = std > 1e-6 * (np.abs(mean) + 1e-6)
    scale = np.where(known, 1.0 / np.where(known, std, 1.0), 0.0)
    return Scaling(mean.astype(np.float32), scale.astype(np.float32))


@dataclass(frozen=True, slots=True)
class Survey:
    """What one pass over the rows tells: enough for every linear part of the model.

    Attributes:
        design: the standardised rows.
        fold: (N,) int64 fold of each row; a roll-out lies in one fold.
        parts: moments of each fold.
        weight: (F,) float64 how far each column is trusted; None = by its correlation.
    """

    design: Design
    fold: NDArray[np.int64]
    parts: tuple[Moments, ...]
    weight: Float | None = None

    def whole(self) -> Moments:
        """Moments of all rows."""
        return added(self.parts)


def added(parts: Sequence[Moments]) -> Moments:
    """Moments of all rows behind `parts`."""
    return functools.reduce(operator.add, parts)


def fold_of(groups: NDArray[np.int64], folds: int, rng: np.random.Generator) -> NDArray[np.int64]:
    """(N,) fold of each row; a roll-out lies in one fold. Too few roll-outs: blocks of rows."""
    distinct, member = np.unique(groups, return_inverse=True)
    if len(distinct) < folds:
        return np.arange(len(groups)) * folds // max(len(groups), 1)
    order = rng.permutation(len(distinct)) % folds
    result: NDArray[np.int64] = order[member]
    return result


def survey(
    design: Design, targets: Float, fold: NDArray[np.int64], weight: Float | None = None
) -> Survey:
    """`Moments` of every fold, in one pass over the rows; they may be memory-mapped."""
    return Survey(design, fold, by_fold(design, targets, fold), weight)


def by_fold(
    design: Design, targets: Float, fold: NDArray[np.int64], count: Float | None = None
) -> tuple[Moments, ...]:
    """Moments of each fold, in one pass; each row counts as (N,) `count` says, None = once."""
    f, d = design.width, targets.shape[1]
    parts = [
        Moments(0, np.zeros(f), np.zeros(d), np.zeros((f, f)), np.zeros((f, d)), np.zeros(d))
        for _ in range(FOLDS)
    ]
    for rows in chunks(len(design)):
        x = design.of(rows)
        y = targets[rows]
        for k in range(FOLDS):
            mine = fold[rows] == k
            parts[k] = parts[k] + _moments(
                x[mine], y[mine], None if count is None else count[rows][mine]
            )
    return tuple(parts)


def _moments(a: Float, b: Float, count: Float | None) -> Moments:
    if count is None:
        return Moments(len(a), a.sum(0), b.sum(0), a.T @ a, a.T @ b, (b * b).sum(0))
    counted = (a * count[:, None]).T
    return Moments(count.sum(), count @ a, count @ b, counted @ a, counted @ b, count @ (b * b))


def correlations(of: Moments) -> Float:
    """(F,) root of each feature's squared correlation with the targets; mean square 1."""
    cross = of.xy / of.n - np.outer(of.x / of.n, of.y / of.n)
    variance = of.xx.diagonal() / of.n - (of.x / of.n) ** 2
    relevance = (cross**2).sum(1) / np.maximum(variance, 1e-12)
    found: Float = np.sqrt(relevance / max(float(relevance.mean()), 1e-300))
    return found


def solve(of: Moments, strength: float, weight: Float | None = None) -> Linear:
    """Ridge regression on features times `weight`.

    Without a weight it is `correlations`: a feature's penalty is `strength` over its squared
    correlation with the targets, so that few telling features are not shrunk with the many that
    say little.
    """
    mean_x, mean_y = of.x / of.n, of.y / of.n
    cov = of.covariance()
    cross = of.xy / of.n - np.outer(mean_x, mean_y)
    weight = correlations(of) if weight is None else weight
    scaled = cov * weight[:, None] * weight
    scaled[np.diag_indices_from(scaled)] += strength
    factor = cho_factor(scaled, lower=True, overwrite_a=True)
    coef = weight[:, None] * cho_solve(factor, weight[:, None] * cross)
    return Linear(coef, mean_y - mean_x @ coef)


def squared_error(of: Moments, model: Linear) -> float:
    """Sum of squared errors of `model` on the rows behind `of`."""
    w, b = model.coef, model.intercept
    fit = (w * (of.xx @ w)).sum() + 2.0 * b @ (of.x @ w) + of.n * (b @ b)
    return float(of.yy.sum() - 2.0 * ((of.xy * w).sum() + of.y @ b) + fit)


@dataclass(frozen=True, slots=True)
class Base:
    """The fitted linear part.

    Attributes:
        linear: fitted on all rows.
        held_out: (N, D) prediction of each row by a model that did not see its roll-out.
        strength: the penalty that was chosen.
    """

    linear: Linear
    held_out: Float
    strength: float


@dataclass(frozen=True, slots=True)
class Judge:
    """Moments from which some folds are judged by what the others tell.

    Attributes:
        known: of all rows, in columns that were chosen without the labels of the held-out folds.
        held: the folds held out.
    """

    known: Survey
    held: tuple[int, ...]

    def unseen(self) -> Moments:
        """Moments of the rows that are held out."""
        return added([self.known.parts[k] for k in self.held])


def fold_by_fold(known: Survey) -> list[Judge]:
    """Every fold judged by all others, in the same columns."""
    return [Judge(known, (k,)) for k in range(len(known.parts))]


def fit_base(targets: Float, known: Survey, judges: Sequence[Judge]) -> Base:
    """Choose the penalty by held-out folds, predict every row held out, and fit on all rows.

    Args:
        targets: (N, D).
        known: of all rows.
        judges: together they hold every fold out once.
    """
    whole = known.whole()
    used = [j for j in judges if 0 < j.unseen().n < whole.n]
    if len(used) < 2:
        linear = Linear(np.zeros((known.design.width, targets.shape[1])), whole.y / whole.n)
        return Base(linear, np.broadcast_to(linear.intercept, targets.shape).copy(), np.inf)
    unseen = [judge.unseen() for judge in used]
    seen = [judge.known.whole() - part for judge, part in zip(used, unseen, strict=True)]
    best, strength, chosen = np.inf, STRENGTHS[-1], list[Linear]()
    for candidate in reversed(STRENGTHS):
        models = [
            solve(part, candidate, judge.known.weight)
            for part, judge in zip(seen, used, strict=True)
        ]
        error = sum(squared_error(part, m) for part, m in zip(unseen, models, strict=True))
        if error < best:
            best, strength, chosen = error, candidate, models
        elif error > 1.002 * best:
            break
    held_out = np.empty_like(targets)
    for rows in chunks(len(targets)):
        for judge, model in zip(used, chosen, strict=True):
            mine = rows.start + np.flatnonzero(np.isin(known.fold[rows], judge.held))
            held_out[mine] = judge.known.design.of(mine) @ model.coef + model.intercept
    return Base(solve(whole, strength, known.weight), held_out, strength)


def no_base(targets: Float, num_features: int) -> Base:
    """The base that is zero everywhere: the trees learn the targets themselves."""
    d = targets.shape[1]
    return Base(Linear(np.zeros((num_features, d)), np.zeros(d)), np.zeros_like(targets), np.inf)
