"""The paper's net: one hidden layer of 128, here with scaled inputs and targets."""

from __future__ import annotations

import numpy as np
from typing_extensions import override

from clothrf_baselines.adam import Adam
from clothrf_baselines.config import MlpConfig
from clothrf_baselines.method import Arrays, Fitted, Method, Predictor, Rows, held_out
from clothrf_core.types import Float, Float32

Weights = dict[str, Float32]


class Mlp(Method):
    """``y = W2 relu(W1 x + b1) + b2``, least squares by Adam, stopped on held-out roll-outs."""

    @override
    def fit(self, rows: Rows, config: MlpConfig, rng: np.random.Generator) -> Fitted:
        train, test = held_out(rows.groups, config.held_out, rng)
        x, y = rows.x, rows.y.astype(np.float32)
        weights = _start(x.shape[1], config.hidden, y.shape[1], rng)
        adam = Adam(weights, rate=config.rate, decay=config.decay, decayed=("w1", "w2"))
        best, best_error, waited, epochs = weights, np.inf, 0, 0
        for _ in range(config.epochs):
            epochs += 1
            for batch in np.array_split(rng.permutation(train), -(-len(train) // config.batch)):
                weights = adam.step(weights, _gradient(weights, x[batch], y[batch]))
            error = float(np.mean((_forward(weights, x[test])[1] - y[test]) ** 2))
            if error < best_error:
                best, best_error, waited = weights, error, 0
            else:
                waited += 1
                if waited >= config.patience:
                    break
        metrics = {"epochs": float(epochs)}
        if np.isfinite(best_error):
            metrics["held_out_error"] = best_error
        return Fitted(best, metrics)

    @override
    def predictor(self, arrays: Arrays, config: MlpConfig) -> Predictor:
        w1, b1, w2, b2 = (arrays[name] for name in ("w1", "b1", "w2", "b2"))
        if w2.shape != (len(b2), len(b1)) or w1.shape[:1] != b1.shape:
            raise ValueError(f"layers {w1.shape} and {w2.shape} do not meet")

        def answer(x: Float32) -> Float:
            hidden = np.maximum(w1 @ x + b1, 0.0)
            result: Float = (w2 @ hidden + b2).astype(np.float64)
            return result

        return answer


def _start(inputs: int, hidden: int, outputs: int, rng: np.random.Generator) -> Weights:
    """He et al. 2015: variances that keep a signal's size through rectified layers."""
    first = rng.standard_normal((hidden, inputs)) * np.sqrt(2.0 / inputs)
    second = rng.standard_normal((outputs, hidden)) * np.sqrt(1.0 / hidden)
    return {
        "w1": first.astype(np.float32),
        "b1": np.zeros(hidden, np.float32),
        "w2": second.astype(np.float32),
        "b2": np.zeros(outputs, np.float32),
    }


def _forward(weights: Weights, x: Float32) -> tuple[Float32, Float32]:
    hidden = np.maximum(x @ weights["w1"].T + weights["b1"], np.float32(0.0))
    return hidden, hidden @ weights["w2"].T + weights["b2"]


def _gradient(weights: Weights, x: Float32, y: Float32) -> Weights:
    """Of the mean squared error, by hand; a test compares it with finite differences."""
    hidden, output = _forward(weights, x)
    to_output = (output - y) * np.float32(2.0 / output.size)
    to_hidden = (to_output @ weights["w2"]) * (hidden > 0.0)
    return {
        "w1": to_hidden.T @ x,
        "b1": to_hidden.sum(axis=0),
        "w2": to_output.T @ hidden,
        "b2": to_output.sum(axis=0),
    }
