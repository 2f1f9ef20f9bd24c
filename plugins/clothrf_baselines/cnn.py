"""A small convolutional net on depth: torch trains it, numpy answers."""

from __future__ import annotations

from collections.abc import Mapping
from typing import Any

import numpy as np
import torch
from torch.nn import functional
from typing_extensions import override

from clothrf_baselines.cnn_answer import HIDDEN, LAYERS, channels, forward, mean_depth
from clothrf_baselines.config import CnnConfig
from clothrf_baselines.depth64 import PIXEL_PREFIX, SIDE
from clothrf_baselines.method import Arrays, Fitted, Method, Predictor, Rows, held_out
from clothrf_core.errors import FeatureMismatch
from clothrf_core.types import Float, Float32


class Cnn(Method):
    """Four strided convolutions and two dense layers on 64 x 64 depth.

    The mean depth, the grippers and the anchor, as far as they are among the features, enter
    after the convolutions, scaled.
    """

    @override
    def fit(self, rows: Rows, config: CnnConfig, rng: np.random.Generator) -> Fitted:
        pixels = np.array([i for i, n in enumerate(rows.names) if n.startswith(PIXEL_PREFIX)])
        if len(pixels) != SIDE * SIDE:
            raise FeatureMismatch(
                f"cnn_depth: expected {SIDE * SIDE} features '{PIXEL_PREFIX}...', got "
                f"{len(pixels)}; use the features 'depth64'"
            )
        others = np.setdiff1d(np.arange(rows.x.shape[1]), pixels)
        pictures = rows.x[:, pixels].reshape(-1, SIDE, SIDE)
        extra = _extra(pictures, rows.x[:, others])
        centre, spread = extra.mean(axis=0), np.maximum(extra.std(axis=0), 1e-6)
        data = (
            torch.from_numpy(channels(pictures)),
            torch.from_numpy((extra - centre) / spread),
            torch.from_numpy(rows.y.astype(np.float32)),
        )
        weights = _start(extra.shape[1], rows.y.shape[1], rng)
        weights, metrics = _train(weights, data, rows, config, rng)
        arrays = {
            **weights,
            "pixels": pixels.astype(np.int32),
            "others": others.astype(np.int32),
            "extra_mean": centre,
            "extra_scale": spread,
        }
        return Fitted(arrays, metrics)

    @override
    def predictor(self, arrays: Arrays, config: CnnConfig) -> Predictor:
        pixels, others = arrays["pixels"], arrays["others"]
        centre, spread = arrays["extra_mean"], arrays["extra_scale"]

        def answer(x: Float32) -> Float:
            picture = x[pixels].reshape(SIDE, SIDE)
            extra = (_extra(picture[None], x[others][None])[0] - centre) / spread
            return forward(arrays, picture, extra).astype(np.float64)

        return answer


def _extra(pictures: Float32, others: Float32) -> Float32:
    return np.concatenate([mean_depth(pictures)[:, None], others], axis=1)


def _start(extras: int, outputs: int, rng: np.random.Generator) -> dict[str, Float32]:
    """Weights after He et al. 2015, drawn from `rng` so that torch's own state is not touched."""
    weights = {}

    def layer(name: str, *shape: int) -> None:
        fan_in = int(np.prod(shape[1:]))
        drawn = rng.standard_normal(shape) * np.sqrt(2.0 / fan_in)
        weights[f"{name}_w"] = drawn.astype(np.float32)
        weights[f"{name}_b"] = np.zeros(shape[0], np.float32)

    inputs, side = 2, SIDE
    for name, width, size, stride in LAYERS:
        layer(name, width, inputs, size, size)
        inputs, side = width, side // stride
    layer("f1", HIDDEN, inputs * side * side + extras)
    layer("f2", outputs, HIDDEN)
    return weights


def _train(
    start: Mapping[str, Float32],
    data: tuple[Any, Any, Any],
    rows: Rows,
    config: CnnConfig,
    rng: np.random.Generator,
) -> tuple[dict[str, Float32], dict[str, float]]:
    """Adam on mean squared error, stopped on held-out roll-outs; the best weights win."""
    train, test = held_out(rows.groups, config.held_out, rng)
    weights = {n: torch.from_numpy(np.array(a)).requires_grad_() for n, a in start.items()}
    adam = torch.optim.AdamW(weights.values(), lr=config.rate, weight_decay=config.decay)
    best, best_error, waited, epochs = _numpy(weights), np.inf, 0, 0
    for _ in range(config.epochs):
        epochs += 1
        for batch in np.array_split(rng.permutation(train), -(-len(train) // config.batch)):
            adam.zero_grad()
            loss = _loss(weights, data, batch)
            loss.backward()
            adam.step()
        with torch.no_grad():
            parts = np.array_split(test, -(-len(test) // 512))
            error = sum(float(_loss(weights, data, p)) * len(p) for p in parts) / len(test)
        if error < best_error:
            best, best_error, waited = _numpy(weights), error, 0
        else:
            waited += 1
            if waited >= config.patience:
                break
    metrics = {"epochs": float(epochs)}
    if np.isfinite(best_error):
        metrics["held_out_error"] = float(best_error)
    return best, metrics


def _loss(weights: Mapping[str, Any], data: tuple[Any, Any, Any], batch: np.ndarray) -> Any:
    x, extra, y = (part[torch.from_numpy(batch)] for part in data)
    for name, _, size, stride in LAYERS:
        x = functional.conv2d(
            x, weights[f"{name}_w"], weights[f"{name}_b"], stride=stride, padding=size // 2
        )
        x = functional.relu(x)
    x = torch.cat([x.flatten(1), extra], dim=1)
    x = functional.relu(functional.linear(x, weights["f1_w"], weights["f1_b"]))
    x = functional.linear(x, weights["f2_w"], weights["f2_b"])
    return functional.mse_loss(x, y)


def _numpy(weights: Mapping[str, Any]) -> dict[str, Float32]:
    return {name: array.detach().numpy().copy() for name, array in weights.items()}
