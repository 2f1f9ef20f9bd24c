"""The mean, least squares, and ridge regression."""

from __future__ import annotations

from typing import Any

import numpy as np
from typing_extensions import override

from clothrf_baselines.config import BaselineConfig, RidgeConfig
from clothrf_baselines.method import Arrays, Fitted, Method, Predictor, Rows, folds
from clothrf_core.types import Float, Float32

# Strengths tried, for features of unit variance and N rows as a share of N.
_LADDER = np.logspace(-6.0, 1.0, 15)


class Constant(Method):
    """Always the mean: what a policy scores that looks at nothing."""

    @override
    def fit(self, rows: Rows, config: BaselineConfig, rng: np.random.Generator) -> Fitted:
        return Fitted({"offset": rows.y.mean(axis=0)})

    @override
    def predictor(self, arrays: Arrays, config: BaselineConfig) -> Predictor:
        offset: Float = arrays["offset"]
        return lambda x: offset


class Linear(Method):
    """Least squares of least norm, without regularisation (scikit-learn's LinearRegression)."""

    @override
    def fit(self, rows: Rows, config: BaselineConfig, rng: np.random.Generator) -> Fitted:
        x, x_mean, y_mean = _centred(rows)
        solution, _, rank, _ = np.linalg.lstsq(x, rows.y - y_mean, rcond=None)
        weights: Float = np.asarray(solution, np.float64)
        return Fitted(line(weights, x_mean, y_mean), {"rank": float(rank)})

    @override
    def predictor(self, arrays: Arrays, config: BaselineConfig) -> Predictor:
        return affine(arrays)


class Ridge(Method):
    """Ridge regression; the strength is the best of a ladder on left-out roll-outs."""

    @override
    def fit(self, rows: Rows, config: RidgeConfig, rng: np.random.Generator) -> Fitted:
        x, x_mean, y_mean = _centred(rows)
        y = rows.y - y_mean
        alpha = config.alpha
        parts = folds(rows.groups, config.folds)
        if alpha is None:
            alpha = _best_alpha(x, y, parts) if parts else 1e-2 * len(x)
        weights = _solutions(x.T @ x, x.T @ y, np.array([alpha]))[0]
        return Fitted(line(weights, x_mean, y_mean), {"alpha": float(alpha)})

    @override
    def predictor(self, arrays: Arrays, config: RidgeConfig) -> Predictor:
        return affine(arrays)


def _best_alpha(x: Float, y: Float, parts: list[Any]) -> float:
    alphas = _LADDER * len(x)
    moments = [(x[part].T @ x[part], x[part].T @ y[part]) for part in parts]
    gram = np.sum([m[0] for m in moments], axis=0)
    cross = np.sum([m[1] for m in moments], axis=0)
    errors = np.zeros(len(alphas))
    for part, (part_gram, part_cross) in zip(parts, moments, strict=True):
        for i, weights in enumerate(_solutions(gram - part_gram, cross - part_cross, alphas)):
            errors[i] += float(np.sum((x[part] @ weights - y[part]) ** 2))
    return float(alphas[int(np.argmin(errors))])


def _solutions(gram: Float, cross: Float, alphas: Float) -> list[Float]:
    """(G + alpha I)^-1 C for every alpha, by one eigendecomposition."""
    values, vectors = np.linalg.eigh(gram)
    values = np.maximum(values, 0.0)
    rotated = vectors.T @ cross
    # The null space of G holds nothing of C; a zero alpha must not divide by it.
    return [vectors @ (rotated / np.maximum(values + a, 1e-12)[:, None]) for a in alphas]


def _centred(rows: Rows) -> tuple[Float, Float, Float]:
    x = rows.x.astype(np.float64)
    x_mean, y_mean = x.mean(axis=0), rows.y.mean(axis=0)
    return x - x_mean, x_mean, y_mean


def line(weights: Float, x_mean: Float, y_mean: Float) -> Arrays:
    """Arrays of ``y = y_mean + W (x - x_mean)`` with (f, D) `weights`, for `affine`."""
    return {"weights": np.ascontiguousarray(weights.T), "offset": y_mean - x_mean @ weights}


def affine(arrays: Arrays) -> Predictor:
    """The answers of a linear map made by `line`."""
    weights: Float = arrays["weights"]
    offset: Float = arrays["offset"]
    if weights.ndim != 2 or offset.shape != weights.shape[:1]:
        raise ValueError(f"weights {weights.shape} and offset {offset.shape}")

    def answer(x: Float32) -> Float:
        result: Float = weights @ x.astype(np.float64) + offset
        return result

    return answer
