"""Features to at most 256 levels, in chunks: what the trees are grown on.

A level is a half-open range of values: ``level(x) = number of edges below x``, so that
``level(x) <= c`` exactly when ``x <= edges[c]``. Trees are grown on levels and act on values.
"""

from __future__ import annotations

from collections.abc import Iterator
from concurrent.futures import ThreadPoolExecutor
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from clothrf_core.types import Float32
from clothrf_forest.rows import Rows

CHUNK = 8192


@dataclass(frozen=True, slots=True)
class Columns:
    """What a split may look at: a feature, or the difference of two.

    Attributes:
        first: (C,) int32 feature index.
        second: (C,) int32 feature subtracted from it, or -1.
    """

    first: NDArray[np.int32]
    second: NDArray[np.int32]

    def of(self, values: Float32) -> Float32:
        """(n, C) float32 columns of (n, F) features."""
        plain = self.second < 0
        if plain.all() and np.array_equal(self.first, np.arange(values.shape[1])):
            return values
        out: Float32 = values[:, self.first]
        out[:, ~plain] -= values[:, self.second[~plain]]
        return out


def offered_columns(num_features: int, pairs: int, width: int, rng: np.random.Generator) -> Columns:
    """All features, `pairs` random differences s_i - s_j of two, and the rest up to `width`."""
    i = rng.integers(num_features, size=pairs)
    j = (i + rng.integers(1, max(num_features, 2), size=pairs)) % num_features
    rest = np.arange(num_features, width)
    first = np.concatenate([np.arange(num_features), i, rest])
    second = np.concatenate([np.full(num_features, -1), j, np.full(len(rest), -1)])
    return Columns(first.astype(np.int32), second.astype(np.int32))


def chunks(num_rows: int, size: int = CHUNK) -> Iterator[slice]:
    """Consecutive row ranges that cover all rows."""
    for start in range(0, num_rows, size):
        yield slice(start, min(start + size, num_rows))


def edges(values: Float32, levels: int = 256) -> list[Float32]:
    """Sorted float32 edges of every column of (n, C) `values`; at most ``levels - 1`` each.

    Midway between neighbouring values where there are few, midway at quantiles otherwise.
    """
    result: list[Float32] = []
    ordered = np.sort(np.ascontiguousarray(values.T), axis=1)
    for column in ordered:
        distinct = column[np.concatenate([[True], column[1:] != column[:-1]])]
        if distinct.size > levels:
            at = np.linspace(0, column.size - 1, levels + 1)[1:-1]
            below = column[at.astype(np.int64)]
            k = np.unique(np.searchsorted(distinct, below))
            k = k[k + 1 < distinct.size]
        else:
            k = np.arange(distinct.size - 1)
        low, high = distinct[k], distinct[k + 1]
        # The rounded middle may equal `high`; the lower neighbour separates the two just as well.
        middle = (low + (high - low) * np.float32(0.5)).astype(np.float32)
        result.append(np.where(middle < high, middle, low))
    return result


def encoded(
    values: Rows, of: Columns, cuts: list[Float32], *, threads: int = 1
) -> NDArray[np.uint8]:
    """(C, N) uint8 levels of all rows, read once in chunks."""
    codes = np.empty((len(cuts), len(values)), np.uint8)

    def one(rows: slice) -> None:
        block = np.ascontiguousarray(of.of(values[rows]).T)
        for c, cut in enumerate(cuts):
            codes[c, rows] = np.searchsorted(cut, block[c], side="left")

    with ThreadPoolExecutor(max_workers=threads) as pool:
        list(pool.map(one, chunks(len(values))))
    return codes
