"""The same forest as a scikit-learn regressor, for pipelines, grids and comparisons."""

from __future__ import annotations

from typing import Any, Self

import numpy as np
from numpy.typing import ArrayLike
from sklearn.base import BaseEstimator, RegressorMixin
from sklearn.utils.validation import check_is_fitted, check_random_state, validate_data

from clothrf_core.types import DatasetView, Float
from clothrf_forest.config import ForestConfig, LabelsConfig
from clothrf_forest.fitting import fit_model
from clothrf_forest.model import Model
from clothrf_forest.ridge import Scaling
from clothrf_forest.traverse import leaves_of


class WrinkleForestRegressor(RegressorMixin, BaseEstimator):  # type: ignore[misc]
    """Regression by a forest whose trees learn what a smooth base leaves.

    Targets may have one or several columns. They are standardised inside, so the bandwidth of
    mean shift is in standard deviations here.

    Args:
        trees: number of trees.
        topology: "variance" or "entropy-labels" (the paper).
        base: "quadratic", "ridge" or "none".
        leaves: "linear", "mean" or "refined".
        max_depth: levels below the root.
        min_impurity_decrease: what a split must gain.
        min_samples_leaf: rows a leaf must hold; 0 = 20 for linear leaves, 1 for the others.
        max_features: columns tried at a node, or "sqrt".
        bandwidth: of mean shift, in standard deviations of the targets.
        threads: of `fit`; 0 = all cores.
        random_state: seed, `numpy.random.RandomState` or None.

    Attributes:
        model_: the fitted `Model`; its one task is all targets.
        n_features_in_: columns seen in `fit`.
    """

    def __init__(
        self,
        *,
        trees: int = 100,
        topology: str = "variance",
        base: str = "quadratic",
        leaves: str = "linear",
        max_depth: int = 20,
        min_impurity_decrease: float = 2e-3,
        min_samples_leaf: int = 0,
        max_features: int | str = "sqrt",
        bandwidth: float = 0.5,
        threads: int = 0,
        random_state: Any = None,
    ) -> None:
        self.trees = trees
        self.topology = topology
        self.base = base
        self.leaves = leaves
        self.max_depth = max_depth
        self.min_impurity_decrease = min_impurity_decrease
        self.min_samples_leaf = min_samples_leaf
        self.max_features = max_features
        self.bandwidth = bandwidth
        self.threads = threads
        self.random_state = random_state

    def fit(self, X: ArrayLike, y: ArrayLike, groups: ArrayLike | None = None) -> Self:
        """Fit on (n, F) rows and (n,) or (n, D) targets; a group is held out as a whole."""
        values, targets = validate_data(self, X, y, multi_output=True, y_numeric=True)
        targets = np.asarray(targets, np.float64)
        self._flat = targets.ndim == 1
        table = targets.reshape(len(targets), -1)
        self._mean = table.mean(0)
        spread = table.std(0)
        self._unit = np.where(spread > 0.0, spread, 1.0)
        config = ForestConfig.model_validate(
            {
                "trees": self.trees,
                "topology": self.topology,
                "base": self.base,
                "leaves": self.leaves,
                "target_frame": "world",
                "use_anchor": False,
                "max_depth": self.max_depth,
                "min_impurity_decrease": self.min_impurity_decrease,
                "min_samples_leaf": self.min_samples_leaf,
                "max_features": self.max_features,
                "bootstrap": "rows" if groups is None else "groups",
                "labels": LabelsConfig(bandwidth=self.bandwidth),
                "threads": self.threads,
            }
        )
        member = np.arange(len(table)) if groups is None else np.asarray(groups)
        view = _as_view(values, (table - self._mean) / self._unit, member)
        seed = check_random_state(self.random_state).randint(2**31 - 1)
        self.model_: Model = fit_model(view, config, np.random.default_rng(seed))[0]
        return self

    def predict(self, X: ArrayLike) -> Float:
        """(n,) or (n, D) targets of (n, F) rows."""
        check_is_fitted(self)
        values = validate_data(self, X, reset=False)
        model = self.model_
        rows = _narrow(values)
        z = Scaling(model.centre, model.scale).of(rows)
        asked = (z @ model.projections.axes + model.projections.offset).astype(np.float32)
        leaf = leaves_of(model.trees, np.concatenate([rows, asked], axis=1))
        votes = model.values[0][leaf].astype(np.float64)
        for i in range(model.slopes.shape[2]):
            votes += asked[:, None, i : i + 1] * model.slopes[0][leaf, i]
        found = votes.mean(1)
        bent = np.concatenate([z, model.curves.of(z)], axis=1)
        found += bent @ model.coef[0] + model.intercept[0]
        table: Float = found[:, : len(self._unit)] * self._unit + self._mean
        return table[:, 0] if self._flat else table

    def __sklearn_tags__(self) -> Any:
        tags = super().__sklearn_tags__()
        tags.target_tags.multi_output = True
        return tags


def _narrow(values: Any) -> Any:
    """Float32 as the trees compare them; what is too large for it stays finite."""
    limit = np.finfo(np.float32).max
    return np.ascontiguousarray(np.clip(values, -limit, limit), np.float32)


def _as_view(values: Any, table: Float, groups: Any) -> DatasetView:
    """Rows as the policy knows them: D targets padded to the 3 G numbers of one task."""
    n, d = table.shape
    g = -(-d // 3)
    labels = np.zeros((n, g * 3))
    labels[:, :d] = table
    return DatasetView(
        features=_narrow(values),
        names=tuple(f"x{i}" for i in range(values.shape[1])),
        anchors=np.zeros((n, 3)),
        labels=labels.reshape(n, 1, g, 3),
        tasks=("all",),
        groups=np.unique(groups, return_inverse=True)[1].astype(np.int64),
        grasps=np.zeros((n, g, 3)),
    )
