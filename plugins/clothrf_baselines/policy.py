"""Every baseline as a `Policy`: which features, which frame, which scale; then its method."""

from __future__ import annotations

import time
from collections.abc import Mapping
from pathlib import Path
from typing import Self

import numpy as np
from numpy.typing import NDArray
from typing_extensions import override

from clothrf_baselines import storage
from clothrf_baselines.config import BaselineConfig
from clothrf_baselines.method import Method, Predictor, Rows
from clothrf_baselines.storage import Fit
from clothrf_core.errors import DataError, FeatureMismatch, suggestion
from clothrf_core.interfaces import Policy
from clothrf_core.types import Action, DatasetView, Features, Float, Float32

# A feature that varies less than this, relative to its size, is left unscaled: it says nothing.
_CONSTANT = 1e-6


class Baseline(Policy):
    """A method between two scalings, relative to the anchor or in the world.

    A picture that is not valid, holds numbers that are not finite, or has no answer is answered
    with the mean action of the training rows and confidence 0.
    """

    def __init__(self, name: str, config: BaselineConfig, method: Method) -> None:
        self.name = name
        self.config = config
        self._method = method
        self._fit: Fit | None = None
        self._answer: Predictor | None = None
        self._known: tuple[str, ...] = ()
        # One answer holds all tasks: asked for the next task, the same picture is not judged again.
        self._asked: Features | None = None
        self._said: Float | None = None

    @property
    @override
    def tasks(self) -> tuple[str, ...]:
        return () if self._fit is None else self._fit.tasks

    @override
    def fit(self, view: DatasetView, rng: np.random.Generator) -> Mapping[str, float]:
        start = time.perf_counter()
        if len(view) == 0:
            raise DataError(f"{self.name}: expected rows to learn from, got none; collect first")
        columns = self._columns(view.names)
        x = view.features[:, columns]
        if self.config.use_anchor:
            x = np.concatenate([x, view.anchors.astype(np.float32)], axis=1)
        y = view.labels
        if self.config.target_frame == "anchor":
            y = y - view.anchors[:, None, None, :]
        y = y.reshape(len(view), -1)
        x_mean, x_scale = _scaling(x.astype(np.float64), wanted=self.config.scale_inputs)
        y_mean, y_scale = _scaling(y, wanted=self.config.scale_targets)
        names = tuple(view.names[i] for i in columns)
        if self.config.use_anchor:
            names += ("anchor_x", "anchor_y", "anchor_z")
        rows = Rows(
            x=((x - x_mean) / x_scale).astype(np.float32),
            y=(y - y_mean) / y_scale,
            groups=view.groups,
            names=names,
        )
        learnt = self._method.fit(rows, self.config, rng)
        self._use(
            Fit(
                names=view.names,
                tasks=view.tasks,
                num_grasps=view.labels.shape[2],
                columns=columns.astype(np.int32),
                x_mean=x_mean.astype(np.float32),
                x_scale=x_scale.astype(np.float32),
                y_mean=y_mean,
                y_scale=y_scale,
                fallback=view.labels.mean(axis=0),
                arrays={name: np.array(array) for name, array in learnt.arrays.items()},
            )
        )
        return {**learnt.metrics, "fit_s": time.perf_counter() - start}

    @override
    def act(self, features: Features, task: str) -> Action:
        fit, answer = self._ready()
        if features.names is not self._known:
            self._check_names(features.names)
        try:
            index = fit.tasks.index(task)
        except ValueError:
            hint = suggestion(task, fit.tasks)
            raise DataError(f"{self.name}: not fitted for task '{task}'. {hint}") from None
        if features is not self._asked:
            x = self._row(features, fit)
            sound = features.valid and bool(np.isfinite(x).all())
            self._said, self._asked = answer(x) if sound else None, features
        y = self._said
        if y is None or not np.isfinite(y).all():
            return Action(targets=np.array(fit.fallback[index]), confidence=0.0)
        targets: Float = (y * fit.y_scale + fit.y_mean).reshape(fit.fallback.shape)[index]
        if self.config.target_frame == "anchor":
            targets = targets + features.anchor
        return Action(targets=np.array(targets), confidence=1.0)

    @override
    def save(self, folder: Path) -> None:
        storage.save(self._ready()[0], self.name, self.config, folder)

    @override
    def load(self, folder: Path) -> Self:
        fit, config = storage.load(self.name, type(self.config), folder)
        loaded = type(self)(self.name, config, self._method)
        try:
            loaded._use(fit)
            row = np.zeros(len(fit.x_mean), np.float32)
            answer = loaded._ready()[1](row)
        except (KeyError, ValueError, IndexError, TypeError) as error:
            raise DataError(f"{folder}: the arrays do not fit together ({error})") from error
        if answer is not None and np.shape(answer) != fit.y_mean.shape:
            raise DataError(
                f"{folder}: expected answers of {fit.y_mean.shape}, got {np.shape(answer)}"
            )
        return loaded

    def _row(self, features: Features, fit: Fit) -> Float32:
        x = features.values[fit.columns]
        if self.config.use_anchor:
            x = np.concatenate([x, features.anchor.astype(np.float32)])
        result: Float32 = (x - fit.x_mean) / fit.x_scale
        return result

    def _columns(self, names: tuple[str, ...]) -> NDArray[np.intp]:
        prefix = self.config.prefix
        columns = np.array([i for i, n in enumerate(names) if n.startswith(prefix)], np.intp)
        if columns.size == 0:
            raise FeatureMismatch(
                f"{self.name}: expected features whose names begin with '{prefix}', got "
                f"{len(names)} like '{names[0]}'. Choose the extractor that makes them (or "
                "'joined'), or set 'prefix'"
            )
        return columns

    def _ready(self) -> tuple[Fit, Predictor]:
        if self._fit is None or self._answer is None:
            raise DataError(f"{self.name}: it knows nothing yet; call fit or load first")
        return self._fit, self._answer

    def _use(self, fit: Fit) -> None:
        self._answer = self._method.predictor(fit.arrays, self.config)
        self._fit = fit
        self._known = fit.names
        self._asked = None

    def _check_names(self, names: tuple[str, ...]) -> None:
        wanted = self._ready()[0].names
        if names != wanted:
            differ = [a for a, b in zip(names, wanted, strict=False) if a != b]
            first = f"; the first that differs is '{differ[0]}'" if differ else ""
            raise FeatureMismatch(
                f"{self.name}: expected the {len(wanted)} features it was fitted on, got "
                f"{len(names)}{first}. Use the feature extractor of the training run"
            )
        self._known = names


def _scaling(values: Float, *, wanted: bool) -> tuple[Float, Float]:
    """Mean and standard deviation of each column, or 0 and 1."""
    if not wanted:
        return np.zeros(values.shape[1]), np.ones(values.shape[1])
    mean, scale = values.mean(axis=0), values.std(axis=0)
    scale = np.where(scale > _CONSTANT * (1e-6 + np.abs(mean)), scale, 1.0)
    return mean, scale
