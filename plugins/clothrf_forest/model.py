"""A fitted forest: nothing but arrays, names and the settings that made them."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass

import numpy as np

from clothrf_core.types import Float, Float32
from clothrf_forest.confidence import Calibration
from clothrf_forest.curves import Curves
from clothrf_forest.novelty import Novelty
from clothrf_forest.projections import Projections
from clothrf_forest.trees import Trees


@dataclass(frozen=True, slots=True, eq=False)
class Model:
    """All that acting needs.

    Attributes:
        names: F feature names.
        tasks: T task names.
        num_grasps: G.
        config: `ForestConfig.stored()` of the fit.
        trees: where the trees send a row.
        values: (T, L, 3 G) float32 answer of every leaf, per task, m.
        slopes: (T, L, s, 3 G) float32 change of it along each projection; s = 0: none.
        variance: (T, L) float32 spread of the leaf's rows, m^2.
        usual: (L,) float32 mean logarithm of the novelty scores of the leaf's rows.
        centre: (F,) float32 mean of the features; F counts the anchor's three where it is used.
        scale: (F,) float32 inverse standard deviation of the features.
        curves: products of directions that the base uses besides the features.
        coef: (T, F + P, 3 G) float32 base on standardised features and products.
        intercept: (T, 3 G) float64, m.
        projections: linear columns that the trees may ask for behind all features.
        novelty: what a picture like the trained ones looks like.
        calibration: from doubt to the chance of a small error.
    """

    names: tuple[str, ...]
    tasks: tuple[str, ...]
    num_grasps: int
    config: Mapping[str, object]
    trees: Trees
    values: Float32
    slopes: Float32
    variance: Float32
    usual: Float32
    centre: Float32
    scale: Float32
    curves: Curves
    coef: Float32
    intercept: Float
    projections: Projections
    novelty: Novelty
    calibration: Calibration

    @property
    def anchored(self) -> bool:
        """Answers are relative to the anchor of the picture."""
        return self.config["target_frame"] == "anchor"


def flat_values(values: Float32, tasks: int) -> Float32:
    """(T, L, D / T) of (L, D) leaf answers, contiguous: a task reads only its own numbers."""
    per_task = values.reshape(len(values), tasks, values.shape[-1] // tasks).transpose(1, 0, 2)
    return np.ascontiguousarray(per_task)


def flat_slopes(slopes: Float32, tasks: int) -> Float32:
    """(T, L, s, D / T) of (L, s, D) slopes, contiguous."""
    n, s, d = slopes.shape
    return np.ascontiguousarray(slopes.reshape(n, s, tasks, d // tasks).transpose(2, 0, 1, 3))
