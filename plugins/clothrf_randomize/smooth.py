"""Smooth unit noise: normal numbers at the nodes of a grid, interpolated bilinearly.

Interpolation weights are divided by their root sum of squares, so that the variance is 1 at every
pixel and not only at the nodes.
"""

from __future__ import annotations

from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from clothrf_core.types import Float, Float32


class Weights(NamedTuple):
    """Interpolation along one axis: (n,) int32 node, (n,) float32 weights of it and the next."""

    node: NDArray[np.int32]
    here: Float32
    after: Float32


def weights(pixels: int, nodes: int) -> Weights:
    """Weights for `pixels` spread evenly between the first and the last of `nodes`."""
    position = np.arange(pixels) * ((nodes - 1) / max(pixels - 1, 1))
    index = np.minimum(position.astype(np.int32), nodes - 2)
    after = position - index
    here = 1.0 - after
    norm = np.sqrt(here**2 + after**2)
    return Weights(index, (here / norm).astype(np.float32), (after / norm).astype(np.float32))


def field(nodes: Float32, rows: Weights, columns: Weights) -> Float:
    """(H, W) the whole field of (R, C) `nodes`; the kernels compute it pixel by pixel."""
    across = nodes[:, columns.node] * columns.here + nodes[:, columns.node + 1] * columns.after
    result: Float = (
        across[rows.node] * rows.here[:, None] + across[rows.node + 1] * rows.after[:, None]
    )
    return result
