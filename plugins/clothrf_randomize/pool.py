"""Random numbers for pictures: a pool made once, read from a random place for every row.

A frame needs about half a million random numbers; drawing them would cost more than everything
else. The pool holds 2^18 of each kind. Each row of each frame reads a stretch of it that starts
at its own random place, so two rows agree in no more than a chance overlap.
"""

from __future__ import annotations

from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from clothrf_core.types import Float32

SIZE = 1 << 18
WIDEST = 1 << 13
# Stretches that a row reads: pixel noise, drop-outs, jitter along y, jitter along x.
NOISE, DROP, DOWN, ACROSS = range(4)


class Pool(NamedTuple):
    """Normal and uniform numbers, each (SIZE + WIDEST,) float32; the end repeats the start."""

    normal: Float32
    uniform: Float32


def make_pool(seed: int = 20180227) -> Pool:
    """The pool; always the same one. Normal numbers have mean 0 and variance 1 exactly."""
    rng = np.random.default_rng(seed)
    normal = rng.standard_normal(SIZE)
    normal = ((normal - normal.mean()) / normal.std()).astype(np.float32)
    uniform = rng.random(SIZE, dtype=np.float32)
    return Pool(
        np.concatenate([normal, normal[:WIDEST]]), np.concatenate([uniform, uniform[:WIDEST]])
    )


def starts(rng: np.random.Generator, rows: int) -> NDArray[np.int64]:
    """(rows, 4) int64: where in the pool each row of a frame starts to read."""
    return rng.integers(0, SIZE, size=(rows, 4))
