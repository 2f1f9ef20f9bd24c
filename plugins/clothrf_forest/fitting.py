"""From rows to a `Model`: scale, linear base, labels, trees, leaves, confidence, in this order."""

from __future__ import annotations

import contextlib
import os
from collections.abc import Iterator, Mapping
from dataclasses import replace

import numpy as np
from numpy.typing import NDArray

from clothrf_core.errors import DataError
from clothrf_core.types import DatasetView, Float
from clothrf_forest.binning import edges, encoded, offered_columns
from clothrf_forest.confidence import calibrated
from clothrf_forest.config import ForestConfig
from clothrf_forest.labels import Labels, label_actions
from clothrf_forest.leaves import leaf_numbers, mean_leaves, out_of_bag
from clothrf_forest.linear import linear_leaves
from clothrf_forest.model import Model, flat_slopes, flat_values
from clothrf_forest.novelty import fit_novelty
from clothrf_forest.projections import no_projections, offered, principal_axes
from clothrf_forest.refined import refined_leaves
from clothrf_forest.ridge import fit_base, no_base, survey
from clothrf_forest.rows import Rows
from clothrf_forest.stopping import LADDER, chosen_gain, cut_back
from clothrf_forest.trees import (
    Grower,
    Growth,
    Problem,
    flattened,
    grow_all,
    numba_grower,
    samples,
)

EDGE_ROWS = 20_000
NEVER = np.array([np.inf, np.inf])


def fit_model(
    view: DatasetView, config: ForestConfig, rng: np.random.Generator
) -> tuple[Model, Mapping[str, float]]:
    """Fit `config` on all rows of `view`; the model and what is worth plotting about it.

    The rows are read in chunks and may be memory-mapped. The result depends on the rows, their
    order, the settings and the generator, not on the number of threads.

    Raises:
        DataError: there are no rows, or numbers that are not finite.
    """
    n, tasks, grasps = view.labels.shape[:3]
    if n == 0 or tasks == 0 or not view.names:
        raise DataError(f"forest: expected rows to learn from, got {n} rows of {tasks} tasks")
    targets = actions(view, anchored=config.target_frame == "anchor")
    if not np.isfinite(targets).all():
        raise DataError("forest: expected finite labels, got NaN or infinity in the data set")
    rows = Rows(view.features, view.anchors if config.use_anchor else None)
    seeds = rng.integers(2**62, size=6)
    streams = [np.random.default_rng(int(s)) for s in seeds]
    threads = config.threads or len(os.sched_getaffinity(0))
    with one_blas_thread():
        known = survey(rows, targets, view.groups, streams[0])
        if not np.isfinite(known.by.centre * known.by.scale).all():
            raise DataError("forest: expected finite features, got NaN or infinity in the data set")
        if config.base == "ridge":
            base = fit_base(rows, targets, known)
        else:
            base = no_base(targets, rows.width)
        novelty, scores = fit_novelty(
            rows,
            known,
            components=config.confidence.components,
            quantile=config.confidence.quantile,
        )
        residual = targets - base.held_out
        labels = Labels(np.zeros(n, np.int32), np.zeros((0, targets.shape[1])), 0.0)
        if config.topology == "entropy-labels":
            labels = label_actions(residual, config.labels, streams[1])
        projections, held_out = no_projections(rows.width), None
        if config.oblique and config.base == "ridge":
            projections, held_out = offered(base)
        shown = replace(rows, projections=held_out)
        columns = offered_columns(rows.width, config.pairs, shown.width, streams[2])
        some = _some_rows(n, streams[3])
        cuts = edges(columns.of(shown[some]))
        problem = Problem(
            codes=encoded(shown, columns, cuts, threads=threads),
            labels=labels.index,
            num_labels=len(labels.centres),
            targets=directed(residual),
        )
    linear = config.leaves == "linear" and held_out is not None
    by_oob = config.min_impurity_decrease == "oob"
    growth = Growth(
        max_depth=config.max_depth,
        min_gain=LADDER[0] if by_oob else float(config.min_impurity_decrease),
        node_local=config.gain_mode == "node_local",
        max_features=_tried(config, rows.width),
        min_samples_leaf=config.min_samples_leaf or (20 if linear else 1),
        always=shown.width - rows.width,
    )
    tree_seeds = streams[4].integers(2**62, size=config.trees)
    weights = samples(config.bootstrap, config.subsample, view.groups, tree_seeds)
    grow = grower(config.engine)
    # The fallback mutes a warning, which only one thread at a time may do.
    side_by_side = threads if grow is numba_grower else 1
    grown = grow_all(problem, weights, growth, tree_seeds, grow, threads=side_by_side)
    least = growth.min_gain
    if by_oob:
        least = chosen_gain(grown, weights, residual, tasks)
        grown = [cut_back(tree, least) for tree in grown]
    trees = flattened(grown, columns, cuts)
    leaf = leaf_numbers(grown)
    leaves = mean_leaves(leaf, trees.num_leaves, weights, residual, tasks)
    theta = np.inf
    if config.leaves == "refined":
        leaves, theta = refined_leaves(leaves, leaf, weights, residual, known.fold)
    asked = None
    if linear and held_out is not None:
        asked = held_out
        leaves = linear_leaves(leaves, leaf, weights, residual, asked, config.leaf_penalty)
    honest = out_of_bag(leaf, weights, leaves, tasks, asked)
    wrong = (residual[honest.rows] - honest.prediction).reshape(len(honest.rows), tasks, 3 * grasps)
    error = np.sqrt((wrong**2).mean(2))
    strange = np.sqrt(scores[honest.rows])[:, None]
    model = Model(
        names=view.names,
        tasks=view.tasks,
        num_grasps=grasps,
        config=config.stored(),
        trees=trees,
        values=flat_values(leaves.values, tasks),
        slopes=flat_slopes(leaves.slopes, tasks),
        variance=np.ascontiguousarray(leaves.variance.T),
        centre=known.by.centre,
        scale=known.by.scale,
        coef=flat_values(base.linear.coef.astype(np.float32), tasks),
        intercept=base.linear.intercept.reshape(tasks, -1).copy(),
        projections=projections,
        novelty=novelty if config.confidence.novelty else replace(novelty, limits=NEVER),
        calibration=calibrated(
            honest.spread * strange[:, None], error, config.confidence.tolerance
        ),
    )
    metrics = {
        "leaves": float(trees.num_leaves),
        "leaves_per_tree": trees.num_leaves / config.trees,
        "min_impurity_decrease": least,
        **_error_metrics(wrong, view.tasks),
    }
    if config.base == "ridge":
        metrics["base_held_out_rms_mm"] = 1e3 * float(np.sqrt((residual**2).mean()))
    if problem.num_labels:
        metrics["labels"] = float(problem.num_labels)
        metrics["label_bandwidth_mm"] = 1e3 * labels.bandwidth
    if np.isfinite(theta):
        metrics["refined_theta"] = theta
    return model, metrics


def actions(view: DatasetView, *, anchored: bool) -> Float:
    """(N, T G 3) what is learnt: labels relative to each picture's anchor, or in the world."""
    labels = view.labels - view.anchors[:, None, None, :] if anchored else view.labels
    return np.ascontiguousarray(labels.reshape(len(labels), -1))


def grower(engine: str) -> Grower:
    """What grows a tree: the compiled kernel, or scikit-learn where there is no numba."""
    if engine != "scikit-learn":
        try:
            import clothrf_forest.growth  # noqa: F401
        except ImportError:
            if engine == "numba":
                raise
        else:
            return numba_grower
    from clothrf_forest.reference import sklearn_grower

    return sklearn_grower


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


def _some_rows(n: int, rng: np.random.Generator) -> NDArray[np.int64]:
    """Rows that level edges are taken from, in order; all of them if they are few."""
    rows = np.arange(n)
    return rows if n <= EDGE_ROWS else np.sort(rng.choice(rows, EDGE_ROWS, replace=False))


def directed(targets: Float) -> Float:
    """(N, d) few columns whose variance is that of all T G 3 targets, scaled to 1."""
    mean, axes = principal_axes(targets)
    return np.ascontiguousarray((targets - mean) @ axes)


def _tried(config: ForestConfig, num_features: int) -> int:
    if config.max_features == "sqrt":
        return max(1, round(float(np.sqrt(num_features + config.pairs))))
    return min(config.max_features, num_features + config.pairs)


def _error_metrics(wrong: Float, tasks: tuple[str, ...]) -> dict[str, float]:
    if len(wrong) == 0:
        return {}
    result = {"oob_rms_mm": 1e3 * float(np.sqrt((wrong**2).mean()))}
    for t, task in enumerate(tasks):
        result[f"oob_rms_mm_{task}"] = 1e3 * float(np.sqrt((wrong[:, t] ** 2).mean()))
    return result
