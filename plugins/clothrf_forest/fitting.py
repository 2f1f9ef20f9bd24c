"""From rows to a `Model`: the smooth foundation, the trees, their leaves, the confidence."""

from __future__ import annotations

import contextlib
import os
from collections.abc import Iterator, Mapping
from dataclasses import replace

import numpy as np

from clothrf_core.errors import DataError
from clothrf_core.types import DatasetView, Float
from clothrf_forest.confidence import Calibration, calibrated, doubts
from clothrf_forest.config import ForestConfig
from clothrf_forest.forest import Grown, grown, has_linear_leaves
from clothrf_forest.foundation import Foundation, lay
from clothrf_forest.leaves import Leaves, mean_leaves, out_of_bag
from clothrf_forest.linear import linear_leaves
from clothrf_forest.model import Model, flat_slopes, flat_values
from clothrf_forest.novelty import limited, relative, usual
from clothrf_forest.refined import refined_leaves
from clothrf_forest.rows import Rows


def fit_model(
    view: DatasetView, config: ForestConfig, rng: np.random.Generator
) -> tuple[Model, Mapping[str, float]]:
    """Fit `config` on all rows of `view`; the model and what is worth plotting about it.

    The rows are read in chunks and may be memory-mapped. The result depends on the rows, their
    order, the settings and the generator, not on the number of threads.

    Raises:
        DataError: there are no rows, or numbers that are not finite.
    """
    n, tasks = view.labels.shape[:2]
    if n == 0 or tasks == 0 or not view.names:
        raise DataError(f"forest: expected rows to learn from, got {n} rows of {tasks} tasks")
    targets = actions(view, anchored=config.target_frame == "anchor")
    if not np.isfinite(targets).all():
        raise DataError("forest: expected finite labels, got NaN or infinity in the data set")
    rows = Rows(view.features, view.anchors if config.use_anchor else None)
    first, second = (np.random.default_rng(int(s)) for s in rng.integers(2**62, size=2))
    threads = config.threads or len(os.sched_getaffinity(0))
    with one_blas_thread():
        base = lay(rows, targets, view.groups, config, first, threads=threads)
        trees = grown(base, view.groups, tasks, config, second, threads=threads)
        return assembled(view, config, base, trees)


def assembled(
    view: DatasetView, config: ForestConfig, base: Foundation, trees: Grown
) -> tuple[Model, Mapping[str, float]]:
    """The model of a foundation and trees: leaves filled with the rows, confidence judged."""
    tasks, grasps = view.labels.shape[1:3]
    leaves, facts = _leaves(base, trees, tasks, config)
    used_to = usual(trees.leaf, trees.weights, base.scores, trees.trees.num_leaves)
    novel = relative(trees.leaf, trees.weights, base.scores, used_to)
    leaves, calibration, errors = _judged(base, trees, leaves, novel, view.tasks, config)
    novelty = base.novelty
    if config.confidence.novelty and base.apart:
        novelty = limited(novelty, novel, config.confidence.quantile)
    model = Model(
        names=view.names,
        tasks=view.tasks,
        num_grasps=grasps,
        config=config.stored(),
        trees=trees.trees,
        values=flat_values(leaves.values, tasks),
        slopes=flat_slopes(leaves.slopes, tasks),
        variance=np.ascontiguousarray(leaves.variance.T),
        centre=base.by.centre,
        scale=base.by.scale,
        curves=base.curves,
        coef=flat_values(base.linear.coef.astype(np.float32), tasks),
        intercept=base.linear.intercept.reshape(tasks, 3 * grasps).copy(),
        projections=base.projections,
        usual=used_to,
        novelty=novelty,
        calibration=calibration,
    )
    held_out = {"base_held_out_rms_mm": _rms_mm(base.residual)} if config.base != "none" else {}
    return model, {**trees.facts, **facts, **errors, **held_out}


def actions(view: DatasetView, *, anchored: bool) -> Float:
    """(N, T G 3) what is learnt: labels relative to each picture's anchor, or in the world."""
    labels = view.labels - view.anchors[:, None, None, :] if anchored else view.labels
    return np.ascontiguousarray(labels.reshape(len(labels), -1))


@contextlib.contextmanager
def one_blas_thread() -> Iterator[None]:
    """Linear algebra on one thread: sums split differently by each thread number."""
    try:
        from threadpoolctl import threadpool_limits
    except ImportError:
        yield
        return
    with threadpool_limits(limits=1, user_api="blas"):
        yield


def _leaves(
    base: Foundation, trees: Grown, tasks: int, config: ForestConfig
) -> tuple[Leaves, dict[str, float]]:
    """What the leaves answer, as the config wants it."""
    leaf, weights, residual = trees.leaf, trees.weights, base.residual
    mean = mean_leaves(leaf, trees.trees.num_leaves, weights, residual, tasks)
    if config.leaves == "refined":
        refined, theta = refined_leaves(mean, leaf, weights, residual, base.fold)
        return refined, {"refined_theta": theta} if np.isfinite(theta) else {}
    if has_linear_leaves(config, base.num_projections) and base.rows.projections is not None:
        asked = base.rows.projections
        return linear_leaves(mean, leaf, weights, residual, asked, config.leaf_penalty), {}
    return mean, {}


def _judged(
    base: Foundation,
    trees: Grown,
    leaves: Leaves,
    novel: Float,
    tasks: tuple[str, ...],
    config: ForestConfig,
) -> tuple[Leaves, Calibration, dict[str, float]]:
    """The leaves, no louder than they deserve; confidence and errors.

    All from the rows that each tree left out. Trees that learn what a good base leaves learn much
    noise; the share of their answer that serves those rows best is what is kept of it.
    """
    asked = base.rows.projections
    found = out_of_bag(trees.leaf, trees.weights, leaves, len(tasks), asked)
    m, d = found.prediction.shape
    residual = base.residual[found.rows]
    kept = 1.0
    if config.base != "none" and m > 0:
        square = float((found.prediction**2).sum())
        kept = float(np.clip((residual * found.prediction).sum() / max(square, 1e-300), 0.0, 1.0))
        leaves = replace(
            leaves,
            values=leaves.values * np.float32(kept),
            slopes=leaves.slopes * np.float32(kept),
        )
        found = out_of_bag(trees.leaf, trees.weights, leaves, len(tasks), asked)
    wrong = (residual - found.prediction).reshape(m, len(tasks), d // len(tasks))
    far = base.scores[found.rows][:, None]
    doubt = doubts(found.spread, far, novel[found.rows][:, None])
    error = np.sqrt((wrong**2).mean(2))
    calibration = calibrated(doubt, error, config.confidence.tolerance)
    if m == 0:
        return leaves, calibration, {}
    errors = {f"oob_rms_mm_{task}": _rms_mm(wrong[:, t]) for t, task in enumerate(tasks)}
    return leaves, calibration, {"oob_rms_mm": _rms_mm(wrong), "trees_kept": kept, **errors}


def _rms_mm(wrong: Float) -> float:
    """Root mean square per coordinate, mm."""
    return 1e3 * float(np.sqrt((wrong**2).mean()))
