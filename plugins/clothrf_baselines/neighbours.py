"""Nearest neighbours: on wrinkles, and on small depth pictures as once run on the robot."""

from __future__ import annotations

import numpy as np
from typing_extensions import override

from clothrf_baselines.config import DepthNeighboursConfig, HowNeighboursConfig
from clothrf_baselines.depth64 import GRASP_PREFIX, PIXEL_PREFIX, SIDE
from clothrf_baselines.method import Arrays, Fitted, Method, Predictor, Rows
from clothrf_core.errors import FeatureMismatch
from clothrf_core.types import Float, Float32

PART = 128  # rows


class HowNeighbours(Method):
    """Mean answer of the k rows of least L1 distance."""

    @override
    def fit(self, rows: Rows, config: HowNeighboursConfig, rng: np.random.Generator) -> Fitted:
        return Fitted({"x": rows.x, "y": rows.y}, {"rows": float(len(rows.x))})

    @override
    def predictor(self, arrays: Arrays, config: HowNeighboursConfig) -> Predictor:
        library, targets = arrays["x"], arrays["y"]
        if len(library) != len(targets):
            raise ValueError(f"{len(library)} rows but {len(targets)} answers")

        def answer(x: Float32) -> Float:
            distance = l1(library, x)
            return _mean_of_nearest(
                distance, targets, config.k, inverse=config.weights != "uniform"
            )

        return answer


class DepthNeighbours(Method):
    """Answer of the row whose depth picture is nearest (L1), among rows with like grippers.

    Compared is the lower half of the picture by default; rows whose grippers were farther away
    than the gate do not count, and without any row left there is no answer. Formulas after the
    programs of the first author.
    """

    @override
    def fit(self, rows: Rows, config: DepthNeighboursConfig, rng: np.random.Generator) -> Fitted:
        pixels = _indices(rows.names, PIXEL_PREFIX)
        grasp = _indices(rows.names, GRASP_PREFIX)
        if len(pixels) != SIDE * SIDE:
            raise FeatureMismatch(
                f"knn_depth64: expected {SIDE * SIDE} features '{PIXEL_PREFIX}...', got "
                f"{len(pixels)}; use the features 'depth64'"
            )
        if config.gate > 0.0 and len(grasp) == 0:
            raise FeatureMismatch(
                f"knn_depth64: expected features '{GRASP_PREFIX}...' for the gate, got none; set "
                "features.grasp = true or policy.gate = 0"
            )
        if config.rows == "lower":
            pixels = pixels[len(pixels) // 2 :]
        arrays = {
            "pixels": pixels,
            "grasp": grasp if config.gate > 0.0 else grasp[:0],
            "x": np.ascontiguousarray(rows.x[:, pixels]),
            "held": np.ascontiguousarray(rows.x[:, grasp]),
            "y": rows.y,
        }
        return Fitted(arrays, {"rows": float(len(rows.x))})

    @override
    def predictor(self, arrays: Arrays, config: DepthNeighboursConfig) -> Predictor:
        library, held, targets = arrays["x"], arrays["held"], arrays["y"]
        pixels, grasp = arrays["pixels"], arrays["grasp"]
        if not len(library) == len(held) == len(targets):
            raise ValueError(f"{len(library)} rows but {len(targets)} answers")

        def answer(x: Float32) -> Float | None:
            rows = np.arange(len(library))
            if len(grasp):
                away = (held - x[grasp]).reshape(len(held), -1, 3)
                near = (np.linalg.norm(away, axis=2) <= config.gate).all(axis=1)
                rows = np.flatnonzero(near)
                if len(rows) == 0:
                    return None
            compared = library if len(rows) == len(library) else library[rows]
            distance = l1(compared, x[pixels])
            return _mean_of_nearest(distance, targets[rows], config.k, inverse=False)

        return answer


def l1(library: Float32, x: Float32) -> Float32:
    """(N,) L1 distances of (N, f) rows to one; a part at a time, which stays in the cache."""
    found = np.empty(len(library), np.float32)
    work = np.empty((min(PART, len(library)), library.shape[1]), np.float32)
    for start in range(0, len(library), PART):
        part = library[start : start + PART]
        away = work[: len(part)]
        np.subtract(part, x, out=away)
        np.abs(away, out=away)
        away.sum(axis=1, out=found[start : start + PART])
    return found


def _mean_of_nearest(distance: Float32, targets: Float, k: int, *, inverse: bool) -> Float:
    k = min(k, len(distance))
    # A stable order, so that equal distances always choose the same rows.
    nearest = np.argsort(distance, kind="stable")[:k]
    if not inverse:
        return np.asarray(targets[nearest].mean(axis=0))
    weights = 1.0 / (distance[nearest].astype(np.float64) + 1e-9)
    return np.asarray(weights @ targets[nearest] / weights.sum())


def _indices(names: tuple[str, ...], prefix: str) -> np.ndarray:
    return np.array([i for i, name in enumerate(names) if name.startswith(prefix)], np.int32)
