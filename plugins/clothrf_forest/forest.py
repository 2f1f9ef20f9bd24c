"""The trees of one fit: labels, levels, samples, growth and, if asked for, the stopping rule."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from clothrf_core.types import Float
from clothrf_forest.binning import edges, encoded, offered_columns
from clothrf_forest.config import ForestConfig
from clothrf_forest.foundation import Foundation
from clothrf_forest.labels import label_actions
from clothrf_forest.leaves import leaf_numbers
from clothrf_forest.projections import principal_axes
from clothrf_forest.stopping import LADDER, chosen_gain, cut_back
from clothrf_forest.trees import (
    Grower,
    Growth,
    Problem,
    Trees,
    flattened,
    grow_all,
    numba_grower,
    samples,
)

EDGE_ROWS = 20_000
LINEAR_LEAF_ROWS = 20


@dataclass(frozen=True, slots=True)
class Grown:
    """The trees of a fit and where its rows went.

    Attributes:
        trees: flat nodes.
        leaf: (K, N) int32 leaf of every row in every tree.
        weights: (K, N) uint8 how often each tree saw each row.
        facts: what is worth plotting.
    """

    trees: Trees
    leaf: NDArray[np.int32]
    weights: NDArray[np.uint8]
    facts: dict[str, float]


def grown(
    on: Foundation,
    groups: NDArray[np.int64],
    tasks: int,
    config: ForestConfig,
    rng: np.random.Generator,
    *,
    threads: int,
) -> Grown:
    """Grow `config.trees` trees on what the foundation left; the same for any `threads`."""
    plain = on.rows.width - on.num_projections
    columns = offered_columns(plain, config.pairs, on.rows.width, rng)
    cuts = edges(columns.of(on.rows[some_rows(len(on.rows), rng)]))
    index, facts = _labels(on.targets, config, rng)
    problem = Problem(
        codes=encoded(on.rows, columns, cuts, threads=threads),
        labels=index,
        num_labels=int(facts.get("labels", 0)),
        targets=directed(on.targets),
    )
    growth = _growth(config, plain + config.pairs, on.num_projections)
    seeds = rng.integers(2**62, size=config.trees)
    weights = samples(config.bootstrap, config.subsample, groups, seeds)
    grow = grower(config.engine)
    # The fallback mutes a warning, which only one thread at a time may do.
    side_by_side = threads if grow is numba_grower else 1
    found = grow_all(problem, weights, growth, seeds, grow, threads=side_by_side)
    least = growth.min_gain
    if config.min_impurity_decrease == "oob":
        linear = has_linear_leaves(config, on.num_projections)
        asked = on.rows.projections if linear else None
        least = chosen_gain(
            found, weights, on.residual, tasks, asked=asked, penalty=config.leaf_penalty
        )
        found = [cut_back(tree, least) for tree in found]
    trees = flattened(found, columns, cuts)
    facts = {
        "leaves": float(trees.num_leaves),
        "leaves_per_tree": trees.num_leaves / config.trees,
        "min_impurity_decrease": least,
        **facts,
    }
    return Grown(trees, leaf_numbers(found), weights, facts)


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


def some_rows(n: int, rng: np.random.Generator) -> NDArray[np.int64]:
    """Rows that level edges are taken from, in order; all of them if they are few."""
    rows = np.arange(n)
    return rows if n <= EDGE_ROWS else np.sort(rng.choice(rows, EDGE_ROWS, replace=False))


def directed(targets: Float) -> Float:
    """(N, d) few columns whose variance is that of all T G 3 targets, scaled to 1."""
    mean, axes = principal_axes(targets)
    return np.ascontiguousarray((targets - mean) @ axes)


def has_linear_leaves(config: ForestConfig, num_projections: int) -> bool:
    """Linear leaves need directions; without them leaves hold means."""
    return config.leaves == "linear" and num_projections > 0


def _labels(
    targets: Float, config: ForestConfig, rng: np.random.Generator
) -> tuple[NDArray[np.int32], dict[str, float]]:
    """Label of every row and how many there are; none for trees that reduce variance."""
    if config.topology == "variance":
        return np.zeros(len(targets), np.int32), {}
    labels = label_actions(targets, config.labels, rng)
    facts = {"labels": float(len(labels.centres)), "label_bandwidth_mm": 1e3 * labels.bandwidth}
    return labels.index, facts


def _growth(config: ForestConfig, num_drawable: int, num_projections: int) -> Growth:
    tried, least = config.max_features, config.min_impurity_decrease
    linear = has_linear_leaves(config, num_projections)
    return Growth(
        max_depth=config.max_depth,
        min_gain=LADDER[0] if least == "oob" else float(least),
        node_local=config.gain_mode == "node_local",
        max_features=max(1, round(num_drawable**0.5)) if tried == "sqrt" else tried,
        min_samples_leaf=config.min_samples_leaf or (LINEAR_LEAF_ROWS if linear else 1),
        always=num_projections,
    )
