"""The forest as a `Policy`: fit on rows, act on one, kept as arrays."""

from __future__ import annotations

import time
from collections.abc import Mapping
from dataclasses import dataclass
from pathlib import Path
from typing import Self

import numpy as np
from typing_extensions import override

from clothrf_core.errors import DataError, FeatureMismatch, suggestion
from clothrf_core.interfaces import Policy, Refittable
from clothrf_core.types import Action, DatasetView, Features, Float
from clothrf_forest import storage
from clothrf_forest.answer import (
    CONFIDENCE,
    ERROR,
    EXTRA,
    NOVELTY,
    SPREAD,
    Prepared,
    fastest,
    prepared,
)
from clothrf_forest.config import ForestConfig
from clothrf_forest.fitting import fit_model
from clothrf_forest.model import Model
from clothrf_forest.refill import refilled


@dataclass(frozen=True, slots=True)
class Estimate:
    """An action and all that the forest knows about it.

    Attributes:
        targets: (G, 3) float64, world, m.
        confidence: in [0, 1].
        expected_error: RMS error per coordinate expected from out-of-bag rows, m.
        spread: disagreement of trees and leaves, m.
        novelty: how unlike the trained pictures this one is; about 1 for a known one.
    """

    targets: Float
    confidence: float
    expected_error: float
    spread: float
    novelty: float


class Forest(Policy, Refittable):
    """Random forest controller of Jia et al., single-task and multi-task in one.

    A picture that is not valid, or holds numbers that are not finite, is answered with
    confidence 0.
    """

    def __init__(self, config: ForestConfig) -> None:
        self.config = config
        self._model: Model | None = None
        self._prepared: dict[str, Prepared] = {}
        self._known: tuple[str, ...] = ()
        self._answer = fastest()

    @property
    @override
    def tasks(self) -> tuple[str, ...]:
        return () if self._model is None else self._model.tasks

    @property
    def model(self) -> Model:
        """The fitted arrays.

        Raises:
            DataError: nothing was fitted or loaded yet.
        """
        if self._model is None:
            raise DataError("forest: it knows nothing yet; call fit or load first")
        return self._model

    @override
    def fit(self, view: DatasetView, rng: np.random.Generator) -> Mapping[str, float]:
        start = time.perf_counter()
        model, metrics = fit_model(view, self.config, rng)
        self._use(model)
        return {**metrics, "fit_s": time.perf_counter() - start}

    @override
    def refit(self, view: DatasetView, rng: np.random.Generator) -> Mapping[str, float]:
        start = time.perf_counter()
        model, metrics = refilled(self.model, view, rng)
        self._use(model)
        return {**metrics, "fit_s": time.perf_counter() - start}

    @override
    def act(self, features: Features, task: str) -> Action:
        found = self.estimate(features, task)
        return Action(targets=found.targets, confidence=found.confidence)

    def estimate(self, features: Features, task: str) -> Estimate:
        """What `act` answers, with the numbers behind its confidence.

        Raises:
            FeatureMismatch: the features have other names than those it was fitted on.
            DataError: the forest was not fitted, or not for this task.
        """
        model = self.model
        if features.names is not self._known:
            self._check_names(features.names)
        arrays = self._prepared.get(task)
        if arrays is None:
            raise DataError(f"forest: not fitted for task '{task}'. {suggestion(task, self.tasks)}")
        out = np.empty(3 * model.num_grasps + EXTRA)
        self._answer(features.values, features.anchor, arrays, out)
        targets = out[:-EXTRA].reshape(model.num_grasps, 3)
        sound = features.valid and out[ERROR] < np.inf
        if not sound:
            targets = np.nan_to_num(targets)
        return Estimate(
            targets=targets,
            confidence=float(out[CONFIDENCE]) if sound else 0.0,
            expected_error=float(out[ERROR]) if sound else np.inf,
            spread=float(out[SPREAD]),
            novelty=float(out[NOVELTY]),
        )

    @override
    def save(self, folder: Path) -> None:
        storage.save(self.model, folder)

    @override
    def load(self, folder: Path) -> Self:
        model = storage.load(folder)
        loaded = type(self)(ForestConfig.model_validate(dict(model.config)))
        loaded._use(model)
        return loaded

    def _use(self, model: Model) -> None:
        self._model = model
        self._prepared = {task: prepared(model, t) for t, task in enumerate(model.tasks)}
        self._known = model.names

    def _check_names(self, names: tuple[str, ...]) -> None:
        wanted = self.model.names
        if names != wanted:
            differ = [a for a, b in zip(names, wanted, strict=False) if a != b]
            first = f"; the first that differs is '{differ[0]}'" if differ else ""
            raise FeatureMismatch(
                f"forest: expected the {len(wanted)} features it was fitted on, got "
                f"{len(names)}{first}. Use the feature extractor of the training run"
            )
        self._known = names
