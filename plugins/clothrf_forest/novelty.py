"""Pictures unlike all trained ones: a probabilistic principal component model of the features.

The score of a row is its squared Mahalanobis distance under a Gaussian with a few principal
directions and equal variance in all others (Tipping and Bishop 1999), per feature: about 1 on
rows like the trained ones. Its limits come from roll-outs the model was not fitted on.
"""

from __future__ import annotations

from dataclasses import dataclass, replace

import numpy as np
from scipy.linalg import eigh

from clothrf_core.types import Float, Float32
from clothrf_forest.binning import chunks
from clothrf_forest.ridge import Moments, Survey, added


@dataclass(frozen=True, slots=True)
class Novelty:
    """What standardised features of known pictures look like.

    Attributes:
        mean: (k,) float64 mean along each direction.
        axes: (F, k) float32 orthonormal principal directions.
        precision: (k,) float64 inverse variance along each of them.
        rest: inverse variance in every other direction.
        limits: (2,) float64 scores: up to the first nothing is novel, from the second on all is.
    """

    mean: Float
    axes: Float32
    precision: Float
    rest: float
    limits: Float

    def scores(self, x: Float) -> Float:
        """(n,) score of (n, F) standardised rows."""
        along = x @ self.axes - self.mean
        square = (x * x).sum(1) - ((x @ self.axes) ** 2).sum(1)
        total: Float = (along**2) @ self.precision + np.maximum(square, 0.0) * self.rest
        total /= x.shape[1]
        return total


def principal(of: Moments, components: int) -> Novelty:
    """The model of the rows behind `of`; limits are still infinite."""
    f = len(of.x)
    k = min(components, max(f - 1, 1), max(of.n - 2, 1))
    cov = of.covariance()
    variance, axes = eigh(cov, subset_by_index=[f - k, f - 1])
    left = max(float(np.trace(cov)) - float(variance.sum()), 0.0) / max(f - k, 1)
    floor = max(left, 1e-9)
    return Novelty(
        mean=(of.x / of.n) @ axes,
        axes=np.ascontiguousarray(axes.astype(np.float32)),
        precision=1.0 / np.maximum(variance, floor),
        rest=1.0 / floor,
        limits=np.array([np.inf, np.inf]),
    )


def without_limits(model: Novelty) -> Novelty:
    """The same model, to which nothing is novel."""
    return replace(model, limits=np.array([np.inf, np.inf]))


def fit_novelty(known: Survey, *, components: int, quantile: float) -> tuple[Novelty, Float]:
    """Fit on all rows; and the (N,) scores of the rows.

    Each half of the folds is judged by the other half's model, and the limits come from there. Too
    few rows for that: the scores are the model's own, and there is no limit.
    """
    design = known.design
    model = principal(known.whole(), components)
    halves = [added(known.parts[0::2]), added(known.parts[1::2])]
    if min(half.n for half in halves) < 2 * components:
        return model, model.scores(design.of(slice(None)))
    models = [principal(half, components) for half in halves]
    scores = np.empty(len(design))
    for rows in chunks(len(design)):
        x = design.of(rows)
        odd = known.fold[rows] % 2 == 1
        part = scores[rows]
        part[odd], part[~odd] = models[0].scores(x[odd]), models[1].scores(x[~odd])
    first = float(np.quantile(scores, quantile))
    middle = float(np.median(scores))
    limits = np.array([first, first + max(first - middle, 1e-3)])
    return replace(model, limits=limits), scores
