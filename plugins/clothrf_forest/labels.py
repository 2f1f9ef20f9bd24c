"""Class labels of actions: mean shift (the paper) or k-means.

The paper clusters optimal actions by mean shift so that a classification forest can separate
them. scikit-learn's default bandwidth gives one or two labels here, hence a fixed bandwidth that
is halved until there are enough labels. With several tasks the actions of all are concatenated
and clustered once, so that one labelling, and one forest, serves them all.
"""

from __future__ import annotations

import logging
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from clothrf_core.types import Float
from clothrf_forest.binning import chunks
from clothrf_forest.config import LabelsConfig

logger = logging.getLogger(__name__)


@dataclass(frozen=True, slots=True)
class Labels:
    """Classes of actions.

    Attributes:
        index: (N,) int32 class of each row.
        centres: (C, D) float64.
        bandwidth: the one that gave enough labels, m; 0 for k-means.
    """

    index: NDArray[np.int32]
    centres: Float
    bandwidth: float


def label_actions(actions: Float, config: LabelsConfig, rng: np.random.Generator) -> Labels:
    """Label (N, D) actions as `config` says; at least `config.minimum` classes where possible."""
    n = len(actions)
    distinct = len(np.unique(np.round(actions, 6), axis=0))
    enough = min(config.minimum, distinct)
    if config.method == "mean-shift":
        sample = actions
        if n > config.sample:
            sample = actions[np.sort(rng.choice(n, config.sample, replace=False))]
        bandwidth = config.bandwidth
        while bandwidth > config.bandwidth * 2.0**-8:
            centres = mean_shift(sample, bandwidth, min_points=config.min_points)
            if len(centres) >= enough:
                if bandwidth < config.bandwidth:
                    logger.info(
                        "mean shift: %g m gives fewer than %d labels; %g m gives %d",
                        config.bandwidth, enough, bandwidth, len(centres),
                    )  # fmt: skip
                return Labels(nearest(actions, centres), centres, bandwidth)
            bandwidth *= 0.5
        logger.info("mean shift: no bandwidth gives %d labels; using k-means", enough)
    k = config.clusters or max(config.minimum, n // 30)
    centres = k_means(actions, min(k, distinct), rng)
    return Labels(nearest(actions, centres), centres, 0.0)


def mean_shift(points: Float, bandwidth: float, *, min_points: int = 1) -> Float:
    """(C, D) modes of (N, D) points under a flat kernel, seeded by bins as large as the kernel.

    Modes nearer than `bandwidth` to one with more points are dropped (Comaniciu and Meer 2002, as
    scikit-learn's ``MeanShift(bin_seeding=True)`` does), and so are clusters of fewer than
    `min_points`: their points belong to the nearest mode that is left, if there is any.
    """
    # One seed a bin, and a point of it: with 18 coordinates a bin's centre may have no neighbour.
    _, seeds = np.unique(np.round(points / bandwidth), axis=0, return_index=True)
    modes = points[np.sort(seeds)]
    count = np.zeros(len(modes), np.int64)
    active = np.arange(len(modes))
    for _ in range(300):
        moved, count[active] = _shifted(modes[active], points, bandwidth)
        step = np.linalg.norm(moved - modes[active], axis=1)
        modes[active] = moved
        active = active[(step > 1e-3 * bandwidth) & (count[active] > 0)]
        if active.size == 0:
            break
    modes, count = modes[count > 0], count[count > 0]
    order = np.lexsort((*modes.T[::-1], count))[::-1]
    modes = modes[order]
    kept: list[int] = []
    free = np.ones(len(modes), bool)
    for i in range(len(modes)):
        if free[i]:
            kept.append(i)
            free &= ((modes - modes[i]) ** 2).sum(1) > bandwidth**2
    modes = modes[kept]
    sizes = np.bincount(nearest(points, modes), minlength=len(modes))
    return modes[sizes >= min_points]


def _shifted(modes: Float, points: Float, bandwidth: float) -> tuple[Float, NDArray[np.int64]]:
    """Mean of the points within `bandwidth` of each mode, and how many there are."""
    moved = modes.copy()
    count = np.zeros(len(modes), np.int64)
    for part in chunks(len(modes), 512):
        within = (_squared_distances(modes[part], points) <= bandwidth**2).astype(float)
        count[part] = within.sum(1)
        some = count[part] > 0
        moved[part][some] = (within @ points)[some] / count[part][some, None]
    return moved, count


def _squared_distances(a: Float, b: Float) -> Float:
    """(n, m) squared distances of (n, D) and (m, D) points."""
    distances: Float = (a * a).sum(1)[:, None] + (b * b).sum(1) - 2.0 * (a @ b.T)
    return distances


def nearest(points: Float, centres: Float) -> NDArray[np.int32]:
    """(N,) int32 index of the centre nearest to each point."""
    index = np.empty(len(points), np.int32)
    for part in chunks(len(points)):
        index[part] = _squared_distances(points[part], centres).argmin(1)
    return index


def k_means(points: Float, k: int, rng: np.random.Generator, *, rounds: int = 20) -> Float:
    """(k, D) centres: k-means++ seeds (Arthur and Vassilvitskii 2007), then Lloyd's rounds."""
    centres = np.empty((k, points.shape[1]))
    centres[0] = points[rng.integers(len(points))]
    distance = ((points - centres[0]) ** 2).sum(1)
    for i in range(1, k):
        cumulative = np.cumsum(distance)
        at = np.searchsorted(cumulative, rng.random() * cumulative[-1], side="right")
        centres[i] = points[min(int(at), len(points) - 1)]
        distance = np.minimum(distance, ((points - centres[i]) ** 2).sum(1))
    for _ in range(rounds):
        index = nearest(points, centres)
        count = np.bincount(index, minlength=k)
        total = np.stack([np.bincount(index, c, minlength=k) for c in points.T], axis=1)
        moved = np.where(count[:, None] > 0, total / np.maximum(count, 1)[:, None], centres)
        done = np.array_equal(moved, centres)
        centres = moved
        if done:
            break
    return centres
