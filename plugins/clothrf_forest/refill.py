"""A forest whose trees stay while its leaves learn: fitted anew without being built anew.

The paper's figure of error against iterations has a curve without forest construction. Here that
is: the splits, the base below them and the scaling of the features are those of the first fit, and
what the leaves answer, what is novel, and how sure an answer is come from the rows given now. A
leaf that no row reaches keeps its answer.
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import replace

import numpy as np
from numpy.typing import NDArray

from clothrf_core.errors import FeatureMismatch
from clothrf_core.types import DatasetView, Float
from clothrf_forest.binning import chunks
from clothrf_forest.config import ForestConfig
from clothrf_forest.curves import Curved
from clothrf_forest.fitting import actions, assembled, one_blas_thread
from clothrf_forest.forest import Grown
from clothrf_forest.foundation import Foundation
from clothrf_forest.model import Model
from clothrf_forest.novelty import fit_novelty
from clothrf_forest.ridge import FOLDS, Linear, Scaling, Straight, fold_of, survey
from clothrf_forest.rows import Rows
from clothrf_forest.traverse import leaves_of
from clothrf_forest.trees import samples


def refilled(
    model: Model, view: DatasetView, rng: np.random.Generator
) -> tuple[Model, Mapping[str, float]]:
    """`model` with leaves, novelty and confidence from all rows of `view`.

    The base was fitted on the rows of the first fit, so their residuals are a little too small;
    they are few among many once the data have grown.

    Raises:
        FeatureMismatch: the rows have other features or tasks than the model.
    """
    if view.names != model.names or view.tasks != model.tasks:
        raise FeatureMismatch(
            f"forest: expected the {len(model.names)} features and the tasks "
            f"{', '.join(model.tasks)} it was built on, got {len(view.names)} features for "
            f"{', '.join(view.tasks)}; build it anew on them"
        )
    config = ForestConfig.model_validate(dict(model.config))
    targets = actions(view, anchored=model.anchored)
    with one_blas_thread():
        base = _foundation(model, view, targets, config, rng)
        leaf = _leaf_numbers(model, base.rows)
        seeds = rng.integers(2**62, size=len(leaf))
        weights = samples(config.bootstrap, config.subsample, view.groups, seeds)
        facts = {
            "leaves": float(model.trees.num_leaves),
            "leaves_per_tree": model.trees.num_leaves / len(leaf),
        }
        found, numbers = assembled(view, config, base, Grown(model.trees, leaf, weights, facts))
    empty = np.ones(model.trees.num_leaves, bool)
    empty[np.unique(leaf[weights > 0])] = False
    return (
        replace(
            found,
            values=np.where(empty[:, None], model.values, found.values),
            slopes=np.where(empty[:, None, None], model.slopes, found.slopes),
            variance=np.where(empty, model.variance, found.variance),
            usual=np.where(empty, model.usual, found.usual),
        ),
        {**numbers, "empty_leaves": float(empty.sum())},
    )


def _foundation(
    model: Model,
    view: DatasetView,
    targets: Float,
    config: ForestConfig,
    rng: np.random.Generator,
) -> Foundation:
    """The smooth parts of `model` as they are, and what they leave of the rows of `view`."""
    rows = Rows(view.features, view.anchors if config.use_anchor else None)
    by = Scaling(model.centre, model.scale)
    design = Curved(Straight(rows, by), model.curves)
    coef = np.concatenate(list(model.coef), axis=1).astype(np.float64)
    linear = Linear(coef, model.intercept.ravel())
    residual = np.empty_like(targets)
    projections = np.empty((len(rows), len(model.projections.offset)), np.float32)
    for part in chunks(len(rows)):
        z = design.of(part)
        residual[part] = targets[part] - (z @ linear.coef + linear.intercept)
        projections[part] = z[:, : rows.width] @ model.projections.axes + model.projections.offset
    fold = fold_of(view.groups, FOLDS, rng)
    known = survey(Straight(rows, by), targets, fold)
    novelty, scores, apart = fit_novelty(known, components=config.confidence.components)
    return Foundation(
        by=by,
        curves=model.curves,
        linear=linear,
        projections=model.projections,
        novelty=novelty,
        rows=Rows(rows.features, rows.anchors, projections),
        num_projections=projections.shape[1],
        targets=targets,
        residual=residual,
        scores=scores,
        apart=apart,
        fold=fold,
    )


def _leaf_numbers(model: Model, rows: Rows) -> NDArray[np.int32]:
    """(K, N) leaf of every row in every tree."""
    leaf = np.empty((len(model.trees.roots), len(rows)), np.int32)
    for part in chunks(len(rows)):
        leaf[:, part] = leaves_of(model.trees, rows[part]).T
    return leaf
