"""scikit-learn's regression forests, flattened to arrays: no scikit-learn when acting."""

from __future__ import annotations

from typing import Any

import numpy as np
from sklearn.ensemble import ExtraTreesRegressor, RandomForestRegressor
from typing_extensions import override

from clothrf_baselines.config import TreesConfig
from clothrf_baselines.method import Arrays, Fitted, Method, Predictor, Rows
from clothrf_core.types import Float, Float32


class Trees(Method):
    """A forest of regression trees (Breiman 2001; extra: Geurts, Ernst, Wehenkel 2006).

    Args:
        extra: thresholds at random and no bootstrap.
    """

    def __init__(self, *, extra: bool) -> None:
        self._extra = extra

    @override
    def fit(self, rows: Rows, config: TreesConfig, rng: np.random.Generator) -> Fitted:
        kind = ExtraTreesRegressor if self._extra else RandomForestRegressor
        forest = kind(
            n_estimators=config.trees,
            max_features=config.max_features,
            min_samples_leaf=config.min_samples_leaf,
            max_depth=config.max_depth,
            n_jobs=config.threads or -1,
            random_state=int(rng.integers(2**31)),
        )
        forest.fit(rows.x, rows.y if rows.y.shape[1] > 1 else rows.y[:, 0])
        arrays = _flattened([tree.tree_ for tree in forest.estimators_])
        return Fitted(arrays, {"leaves": float(len(arrays["leaf_values"]))})

    @override
    def predictor(self, arrays: Arrays, config: TreesConfig) -> Predictor:
        feature, threshold, child = (arrays[n] for n in ("feature", "threshold", "child"))
        roots, values = arrays["roots"], arrays["leaf_values"]
        _check(feature, threshold, child, roots, values)

        def answer(x: Float32) -> Float:
            node = roots
            while True:
                split = feature[node]
                inner = split >= 0
                if not inner.any():
                    break
                right = x[split] > threshold[node]
                node = np.where(inner, child[node] + right, node)
            result: Float = values[child[node]].mean(axis=0, dtype=np.float64)
            return result

        return answer


def _flattened(trees: list[Any]) -> Arrays:
    """All nodes of all trees; the two children of a node stand side by side.

    ``feature`` is -1 at a leaf, and ``child`` then its row in ``leaf_values``; otherwise it is the
    left child, and the right one follows.
    """
    feature, threshold, child, roots, values = [], [], [], [], []
    nodes = leaves = 0
    for tree in trees:
        order = _siblings_together(tree.children_left, tree.children_right)
        place = np.empty(len(order), np.int64)
        place[order] = np.arange(len(order))
        left = tree.children_left[order]
        leaf = left < 0
        number = np.cumsum(leaf) - 1
        feature.append(np.where(leaf, -1, tree.feature[order]).astype(np.int32))
        threshold.append(np.where(leaf, 0.0, tree.threshold[order]))
        child.append(np.where(leaf, leaves + number, nodes + place[left]).astype(np.int32))
        values.append(tree.value[order][leaf][:, :, 0].astype(np.float32))
        roots.append(nodes)
        nodes += len(order)
        leaves += int(leaf.sum())
    return {
        "feature": np.concatenate(feature),
        "threshold": np.concatenate(threshold),
        "child": np.concatenate(child),
        "roots": np.array(roots, np.int32),
        "leaf_values": np.concatenate(values),
    }


def _siblings_together(left: np.ndarray, right: np.ndarray) -> np.ndarray:
    """Nodes in an order in which every pair of siblings is adjacent, parents first."""
    order = [0]
    for node in order:
        if left[node] >= 0:
            order += [int(left[node]), int(right[node])]
    return np.array(order)


def _check(
    feature: np.ndarray,
    threshold: np.ndarray,
    child: np.ndarray,
    roots: np.ndarray,
    values: np.ndarray,
) -> None:
    """Every walk must stay inside the arrays and end."""
    nodes = np.arange(len(feature))
    inner = feature >= 0
    sound = (
        len(feature) == len(threshold) == len(child)
        and len(roots) > 0
        and values.ndim == 2
        and bool((roots >= 0).all() and (roots < len(feature)).all())
        and bool((child[inner] > nodes[inner]).all() and (child[inner] + 1 < len(feature)).all())
        and bool((child[~inner] >= 0).all() and (child[~inner] < len(values)).all())
    )
    if not sound:
        raise ValueError("the nodes of a tree point outside it")
