"""One row through the whole model: what the control loop waits for.

`answer` is compiled where numba is installed and plain numpy otherwise; both read the same
`Prepared` arrays of one task and give the same numbers.
"""

from __future__ import annotations

from collections.abc import Callable
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from clothrf_core.types import Float, Float32
from clothrf_forest.model import Model
from clothrf_forest.traverse import leaves_of
from clothrf_forest.trees import Trees


class Prepared(NamedTuple):
    """A model's arrays for one task, laid out to be read once, in order.

    Attributes:
        nodes: (M,) `trees.NODE`.
        roots: (K,) int32.
        values: (L, D) float32 answers of the leaves.
        variance: (L,) float32 spread of the leaves' rows.
        centre: (F,) float32.
        scale: (F,) float32.
        matrix: (F, D + h + k) float32 linear base, projections and principal directions.
        intercept: (D,) float64 of the base.
        offset: (h,) float64 of the projections.
        mean: (k,) float64 of the principal scores.
        precision: (k,) float64.
        rest: inverse variance in all other directions.
    """

    nodes: NDArray[np.void]
    roots: NDArray[np.int32]
    values: Float32
    variance: Float32
    centre: Float32
    scale: Float32
    matrix: Float32
    intercept: Float
    offset: Float
    mean: Float
    precision: Float
    rest: float


Answer = Callable[[Float32, Prepared, Float], None]


def prepared(model: Model, task: int) -> Prepared:
    """The arrays of task number `task`."""
    matrix = np.concatenate([model.coef[task], model.projections.axes, model.novelty.axes], axis=1)
    return Prepared(
        nodes=model.trees.nodes,
        roots=model.trees.roots,
        values=np.ascontiguousarray(model.values[task]),
        variance=np.ascontiguousarray(model.variance[task]),
        centre=model.centre,
        scale=model.scale,
        matrix=np.ascontiguousarray(matrix),
        intercept=np.ascontiguousarray(model.intercept[task]),
        offset=model.projections.offset,
        mean=model.novelty.mean,
        precision=model.novelty.precision,
        rest=model.novelty.rest,
    )


def answer_in_numpy(x: Float32, of: Prepared, out: Float) -> None:
    """Write the (D,) answer, its spread and the novelty score of one row into (D + 2,).

    Args:
        x: (F + h,) float32; the last h numbers are written here.
        of: the model's arrays.
        out: (D + 2,) float64.
    """
    d, h = len(of.intercept), len(of.offset)
    f = len(x) - h
    z = ((x[:f] - of.centre) * of.scale).astype(np.float64)
    along = z @ of.matrix
    x[f:] = along[d : d + h] + of.offset
    leaf = leaves_of(Trees(of.nodes, of.roots, len(of.values)), x[None])[0]
    values = of.values[leaf].astype(np.float64)
    mean = values.mean(0)
    between = (values * values).mean() - (mean * mean).mean()
    inside = along[d + h :]
    known = ((inside - of.mean) ** 2) @ of.precision
    outside = max(float(z @ z - inside @ inside), 0.0) * of.rest
    out[:d] = mean + along[:d] + of.intercept
    out[d] = np.sqrt(max(float(between), 0.0) + of.variance[leaf].mean(dtype=np.float64))
    out[d + 1] = (known + outside) / f


def fastest() -> Answer:
    """The compiled `answer` where numba is installed, the numpy one elsewhere."""
    try:
        from clothrf_forest.compiled import answer
    except ImportError:
        return answer_in_numpy
    compiled: Answer = answer
    return compiled
