"""What is fitted before any tree: the smooth base, what it offers to the trees, and the novelty."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from clothrf_core.errors import DataError
from clothrf_core.types import Float
from clothrf_forest.config import ForestConfig
from clothrf_forest.curves import Curved, Curves, fit_curves, no_curves
from clothrf_forest.novelty import Novelty, fit_novelty, without_limits
from clothrf_forest.projections import Projections, no_projections, offered
from clothrf_forest.ridge import (
    FOLDS,
    Linear,
    Scaling,
    Straight,
    fit_base,
    fold_of,
    no_base,
    spread,
    survey,
)
from clothrf_forest.rows import Rows


@dataclass(frozen=True, slots=True)
class Foundation:
    """The smooth parts of a model, and what they say of the training rows held out.

    Attributes:
        by: how features are standardised.
        curves: what the base is told besides the features.
        linear: the base.
        projections: what trees may ask for besides features; none without a base.
        novelty: what known pictures look like.
        rows: features, anchor and held-out projections of the training rows.
        num_projections: h.
        residual: (N, D) float64 what is left for the trees, m.
        scores: (N,) float64 novelty of the training rows.
        fold: (N,) int64 folds of whole roll-outs.
    """

    by: Scaling
    curves: Curves
    linear: Linear
    projections: Projections
    novelty: Novelty
    rows: Rows
    num_projections: int
    residual: Float
    scores: Float
    fold: NDArray[np.int64]


def lay(
    rows: Rows,
    targets: Float,
    groups: NDArray[np.int64],
    config: ForestConfig,
    rng: np.random.Generator,
) -> Foundation:
    """Fit the smooth parts on `rows` and (N, D) `targets`.

    Raises:
        DataError: a feature is NaN or infinite.
    """
    by = spread(lambda part: rows[part], len(rows), rows.width)
    if not np.isfinite(by.centre * by.scale).all():
        raise DataError("forest: expected finite features, got NaN or infinity in the data set")
    fold = fold_of(groups, FOLDS, rng)
    known = survey(Straight(rows, by), targets, fold)
    wanted = config.confidence
    novelty, scores = fit_novelty(known, components=wanted.components, quantile=wanted.quantile)
    projections, held_out = no_projections(rows.width), np.zeros((len(rows), 0), np.float32)
    base, curves = no_base(targets, rows.width), no_curves(rows.width)
    if config.base != "none":
        base = fit_base(targets, known)
        answers, said = offered(base)
        if config.oblique:
            projections, held_out = answers, said
        if config.base == "quadratic":
            leading = novelty.axes[:, ::-1][:, : config.curve_directions]
            directions = np.concatenate([answers.axes, leading], axis=1).astype(np.float64)
            curves = fit_curves(known.design, directions)
            base = fit_base(targets, survey(Curved(known.design, curves), targets, fold))
    return Foundation(
        by=by,
        curves=curves,
        linear=base.linear,
        projections=projections,
        novelty=novelty if wanted.novelty else without_limits(novelty),
        rows=Rows(rows.features, rows.anchors, held_out),
        num_projections=held_out.shape[1],
        residual=targets - base.held_out,
        scores=scores,
        fold=fold,
    )
