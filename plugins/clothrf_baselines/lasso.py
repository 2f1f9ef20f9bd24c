"""The visual feedback dictionary as it was coded: one Lasso from feature to action differences."""

from __future__ import annotations

import warnings

import numpy as np
from sklearn.exceptions import ConvergenceWarning
from sklearn.linear_model import Lasso
from typing_extensions import override

from clothrf_baselines.config import LassoConfig
from clothrf_baselines.linear import affine, line
from clothrf_baselines.method import Arrays, Fitted, Method, Predictor, Rows


class LassoDictionary(Method):
    """``dx = W ds`` with sparse W, fitted on differences of random rows, or on the rows.

    Sparsity is over features, not over atoms. An answer is the mean action plus W times the
    difference to the mean row.
    """

    @override
    def fit(self, rows: Rows, config: LassoConfig, rng: np.random.Generator) -> Fitted:
        x = rows.x.astype(np.float64)
        x_mean, y_mean = x.mean(axis=0), rows.y.mean(axis=0)
        if config.mode == "differences":
            count = max(2, round(config.pairs * len(x)))
            first, second = rng.integers(0, len(x), size=(2, count))
            inputs, outputs = x[first] - x[second], rows.y[first] - rows.y[second]
        else:
            inputs, outputs = x - x_mean, rows.y - y_mean
        solver = Lasso(
            alpha=config.alpha, fit_intercept=False, max_iter=config.iterations, precompute=True
        )
        with warnings.catch_warnings(record=True) as complaints:
            warnings.simplefilter("always", ConvergenceWarning)
            solver.fit(inputs, outputs)
        weights = np.atleast_2d(solver.coef_).T
        metrics = {
            "features_used": float(np.any(weights != 0.0, axis=1).sum()),
            "converged": float(not complaints),
        }
        return Fitted(line(weights, x_mean, y_mean), metrics)

    @override
    def predictor(self, arrays: Arrays, config: LassoConfig) -> Predictor:
        return affine(arrays)
