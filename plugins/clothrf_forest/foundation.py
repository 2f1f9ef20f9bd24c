"""What is fitted before any tree: the smooth base, what it offers to the trees, and the novelty."""

from __future__ import annotations

from concurrent.futures import ThreadPoolExecutor
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from clothrf_core.errors import DataError
from clothrf_core.types import Float
from clothrf_forest.config import ForestConfig
from clothrf_forest.curves import Curved, Curves, fit_curves, no_curves, trusted
from clothrf_forest.novelty import Novelty, fit_novelty
from clothrf_forest.projections import Projections, no_projections, offered
from clothrf_forest.ridge import (
    FOLDS,
    Base,
    Judge,
    Linear,
    Scaling,
    Straight,
    Survey,
    added,
    correlations,
    fit_base,
    fold_by_fold,
    fold_of,
    no_base,
    spread,
    survey,
)
from clothrf_forest.rows import Rows
from clothrf_forest.telling import telling


@dataclass(frozen=True, slots=True)
class Foundation:
    """The smooth parts of a model, and what they say of the training rows held out.

    Attributes:
        by: how features are standardised.
        curves: what the base is told besides the features.
        linear: the base.
        projections: what trees may ask for besides features; none without a base.
        novelty: what known pictures look like; its limits are still infinite.
        rows: features, anchor and held-out projections of the training rows.
        num_projections: h.
        targets: (N, D) float64 what is answered, m; trees part rows whose answers differ.
        residual: (N, D) float64 what the base leaves of it, m; the leaves answer that.
        scores: (N,) float64 novelty scores of the training rows.
        apart: they come from models of other roll-outs.
        fold: (N,) int64 folds of whole roll-outs.
    """

    by: Scaling
    curves: Curves
    linear: Linear
    projections: Projections
    novelty: Novelty
    rows: Rows
    num_projections: int
    targets: Float
    residual: Float
    scores: Float
    apart: bool
    fold: NDArray[np.int64]


def lay(
    rows: Rows,
    targets: Float,
    groups: NDArray[np.int64],
    config: ForestConfig,
    rng: np.random.Generator,
    *,
    threads: int = 1,
) -> Foundation:
    """Fit the smooth parts on `rows` and (N, D) `targets`; the same for any `threads`.

    Raises:
        DataError: a feature is NaN or infinite.
    """
    by = spread(lambda part: rows[part], len(rows), rows.width)
    if not np.isfinite(by.centre * by.scale).all():
        raise DataError("forest: expected finite features, got NaN or infinity in the data set")
    fold = fold_of(groups, FOLDS, rng)
    known = survey(Straight(rows, by), targets, fold)
    novelty, scores, apart = fit_novelty(known, components=config.confidence.components)
    projections, held_out = no_projections(rows.width), np.zeros((len(rows), 0), np.float32)
    base, curves = no_base(targets, rows.width), no_curves(rows.width)
    if config.base != "none":
        base = fit_base(targets, known, fold_by_fold(known))
        if config.oblique:
            projections, held_out = offered(base)
        if config.base == "quadratic":
            curves, base = _bent(known, targets, config.curve_directions, rng, threads=threads)
    return Foundation(
        by=by,
        curves=curves,
        linear=base.linear,
        projections=projections,
        novelty=novelty,
        rows=Rows(rows.features, rows.anchors, held_out),
        num_projections=held_out.shape[1],
        targets=targets,
        residual=targets - base.held_out,
        scores=scores,
        apart=apart,
        fold=fold,
    )


def _bent(
    known: Survey,
    targets: Float,
    directions: int,
    rng: np.random.Generator,
    *,
    threads: int,
) -> tuple[Curves, Base]:
    """The quadratic base; each third of the roll-outs is judged by what the others tell.

    The labels of that third choose neither its model nor the directions that the model multiplies.
    """
    thirds = [(k, k + 1) for k in range(0, FOLDS, 2)]
    rows = [sum(known.parts[k].n for k in third) for third in thirds]
    judged = [t for t, n in zip(thirds, rows, strict=True) if 0 < n < sum(rows)]
    seeds = rng.integers(2**62, size=1 + len(judged))

    def one(part: tuple[int, ...], seed: int) -> Survey:
        return _curved(known, targets, directions, part, np.random.default_rng(seed))

    with ThreadPoolExecutor(max_workers=threads) as pool:
        whole, *others = pool.map(one, [(), *judged], seeds.tolist())
    judges = [Judge(other, part) for other, part in zip(others, judged, strict=True)]
    assert isinstance(whole.design, Curved)
    return whole.design.curves, fit_base(targets, whole, judges)


def _curved(
    known: Survey,
    targets: Float,
    directions: int,
    without: tuple[int, ...],
    rng: np.random.Generator,
) -> Survey:
    """All rows in the features and the products that the folds but some name."""
    seen = added([part for k, part in enumerate(known.parts) if k not in without])
    weight = correlations(seen)
    among = np.flatnonzero(~np.isin(known.fold, without))
    found = telling(known.design, targets, weight, directions, among, rng)
    curved = Curved(known.design, fit_curves(known.design, found.axes))
    return survey(curved, targets, known.fold, trusted(weight, found.reach))
