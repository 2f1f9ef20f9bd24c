"""What a baseline is made of: something that learns arrays from rows and answers one row."""

from __future__ import annotations

from abc import abstractmethod
from collections.abc import Callable, Mapping
from dataclasses import dataclass, field
from typing import Any, Protocol

import numpy as np
from numpy.typing import NDArray

from clothrf_core.types import Float, Float32

Arrays = Mapping[str, NDArray[Any]]
# (f,) float32 features to (D,) float64 targets; None = no answer, hold.
Predictor = Callable[[Float32], "Float | None"]


@dataclass(frozen=True, slots=True, eq=False)
class Rows:
    """What there is to learn.

    Attributes:
        x: (N, f) float32 features, scaled if the config says so.
        y: (N, D) float64 targets of all tasks, scaled if the config says so.
        groups: (N,) roll-out of each row.
        names: f feature names.
    """

    x: Float32
    y: Float
    groups: NDArray[np.int64]
    names: tuple[str, ...]


@dataclass(frozen=True, slots=True, eq=False)
class Fitted:
    """What was learnt: arrays for the file, numbers for the plot."""

    arrays: Arrays
    metrics: Mapping[str, float] = field(default_factory=dict)


class Method(Protocol):
    """A way to learn; stateless."""

    @abstractmethod
    def fit(self, rows: Rows, config: Any, rng: np.random.Generator) -> Fitted:
        """Learn from all rows."""

    @abstractmethod
    def predictor(self, arrays: Arrays, config: Any) -> Predictor:
        """The function that answers one row.

        Raises:
            KeyError, ValueError, IndexError: the arrays do not fit together.
        """


def held_out(
    groups: NDArray[np.int64], share: float, rng: np.random.Generator
) -> tuple[NDArray[np.intp], NDArray[np.intp]]:
    """Rows to learn from and rows to test on; whole roll-outs, at least one on each side.

    With a single roll-out its last rows are the test.
    """
    known = np.unique(groups)
    if len(known) == 1:
        cut = max(1, min(len(groups) - 1, round(len(groups) * (1.0 - share))))
        return np.arange(cut), np.arange(cut, len(groups))
    count = min(len(known) - 1, max(1, round(share * len(known))))
    test = np.isin(groups, rng.choice(known, size=count, replace=False))
    return np.flatnonzero(~test), np.flatnonzero(test)


def folds(groups: NDArray[np.int64], count: int) -> list[NDArray[np.intp]]:
    """Rows of each of `count` (or fewer) sets of whole roll-outs; empty with one roll-out."""
    known = np.unique(groups)
    if len(known) == 1:
        return []
    parts = [known[i :: min(count, len(known))] for i in range(min(count, len(known)))]
    return [np.flatnonzero(np.isin(groups, part)) for part in parts]
