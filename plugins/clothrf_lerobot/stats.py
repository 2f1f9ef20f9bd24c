"""Statistics as LeRobot keeps them: of each episode, and of all episodes together."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from typing import Any

import numpy as np
from numpy.typing import NDArray

from clothrf_lerobot.columns import Columns

Stats = dict[str, dict[str, NDArray[Any]]]
QUANTILES = {"q01": 0.01, "q10": 0.10, "q50": 0.50, "q90": 0.90, "q99": 0.99}


def episode_stats(columns: Columns) -> Stats:
    """Of (S, n) columns: min, max, mean, std and quantiles (n,) float64, count (1,) int64."""
    return {key: _of(np.asarray(values, np.float64)) for key, values in columns.items()}


def picture_stats(pixels: NDArray[Any], count: int, scale: float) -> dict[str, NDArray[Any]]:
    """Of (P, C) pixels out of `count` pictures, divided by `scale`; each (C, 1, 1)."""
    found = _of(np.asarray(pixels, np.float64) / scale)
    shaped = {key: value[:, None, None] for key, value in found.items() if key != "count"}
    return {**shaped, "count": np.array([count])}


def combined(episodes: Sequence[Stats]) -> Stats:
    """Of all episodes together: the variance by the parallel algorithm (Chan et al. 1979).

    Quantiles of the whole cannot be had from those of its parts; LeRobot takes their mean weighted
    by the episodes' lengths, and so does this.
    """
    return {
        key: _combined([stats[key] for stats in episodes])
        for key in (episodes[0] if episodes else ())
    }


def nested(stats: Stats) -> dict[str, dict[str, Any]]:
    """As JSON holds them."""
    return {key: {name: v.tolist() for name, v in one.items()} for key, one in stats.items()}


def from_nested(stats: Mapping[str, Mapping[str, Any]]) -> Stats:
    """The inverse of `nested`."""
    return {key: {name: np.array(v) for name, v in one.items()} for key, one in stats.items()}


def _of(values: NDArray[Any]) -> dict[str, NDArray[Any]]:
    quantiles = np.quantile(values, list(QUANTILES.values()), axis=0)
    return {
        "min": values.min(axis=0),
        "max": values.max(axis=0),
        "mean": values.mean(axis=0),
        "std": values.std(axis=0),
        "count": np.array([len(values)]),
        **dict(zip(QUANTILES, quantiles, strict=True)),
    }


def _combined(parts: Sequence[Mapping[str, NDArray[Any]]]) -> dict[str, NDArray[Any]]:
    counts = np.array([int(part["count"][0]) for part in parts])
    weights = counts / counts.sum()

    def stacked(name: str) -> NDArray[Any]:
        return np.stack([part[name] for part in parts])

    def weighted(values: NDArray[Any]) -> NDArray[Any]:
        total: NDArray[Any] = np.tensordot(weights, values, axes=1)
        return total

    mean = weighted(stacked("mean"))
    variance = weighted(stacked("std") ** 2 + (stacked("mean") - mean) ** 2)
    return {
        "min": stacked("min").min(axis=0),
        "max": stacked("max").max(axis=0),
        "mean": mean,
        "std": np.sqrt(variance),
        "count": np.array([counts.sum()]),
        **{name: weighted(stacked(name)) for name in QUANTILES},
    }
