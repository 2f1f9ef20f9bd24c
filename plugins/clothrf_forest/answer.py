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
from clothrf_forest.confidence import doubts
from clothrf_forest.curves import products
from clothrf_forest.model import Model
from clothrf_forest.ridge import Scaling
from clothrf_forest.traverse import leaves_of
from clothrf_forest.trees import Trees

# What stands behind the D targets in an answer.
SPREAD, NOVELTY, CONFIDENCE, ERROR = -4, -3, -2, -1
EXTRA = 4


class Prepared(NamedTuple):
    """A model's arrays for one task, laid out to be read once, in order.

    Attributes:
        nodes: (M,) `trees.NODE`.
        roots: (K,) int32.
        values: (L, D) float32 answers of the leaves.
        slopes: (L, s, D) float32 along the first s projections; s = 0 or h.
        variance: (L,) float32 spread of the leaves' rows.
        usual: (L,) float32 mean logarithm of their novelty scores.
        centre: (F,) float32; F counts the anchor's three where they are features.
        scale: (F,) float32.
        matrix: (F, D + h + q + k) float32 linear base, projections, curves' directions, principal
            directions.
        bend: (P, D) float32 of the base's products, not standardised.
        curve_offset: (q,) float64 of their directions.
        intercept: (D,) float64 of the base.
        offset: (h,) float64 of the projections.
        mean: (k,) float64 of the principal scores.
        precision: (k,) float64.
        rest: inverse variance in all other directions.
        limits: (2,) float64 novelty from which confidence falls, and at which it is 0.
        calibration: (3, B) float64 doubt, share of small errors, expected error.
        anchored: targets are relative to the anchor.
    """

    nodes: NDArray[np.void]
    roots: NDArray[np.int32]
    values: Float32
    slopes: Float32
    variance: Float32
    usual: Float32
    centre: Float32
    scale: Float32
    matrix: Float32
    bend: Float32
    curve_offset: Float
    intercept: Float
    offset: Float
    mean: Float
    precision: Float
    rest: float
    limits: Float
    calibration: Float
    anchored: bool


Answer = Callable[[Float32, Float, Prepared, Float], None]


def prepared(model: Model, task: int) -> Prepared:
    """The arrays of task number `task`."""
    f, curves = len(model.centre), model.curves
    parts = [model.coef[task, :f], model.projections.axes, curves.axes, model.novelty.axes]
    bend = curves.by.scale[:, None].astype(np.float64) * model.coef[task, f:]
    known = model.calibration
    return Prepared(
        nodes=model.trees.nodes,
        roots=model.trees.roots,
        values=np.ascontiguousarray(model.values[task]),
        slopes=np.ascontiguousarray(model.slopes[task]),
        variance=np.ascontiguousarray(model.variance[task]),
        usual=model.usual,
        centre=model.centre,
        scale=model.scale,
        matrix=np.ascontiguousarray(np.concatenate(parts, axis=1)),
        bend=np.ascontiguousarray(bend, np.float32),
        curve_offset=curves.offset,
        intercept=model.intercept[task] - curves.by.centre.astype(np.float64) @ bend,
        offset=model.projections.offset,
        mean=model.novelty.mean,
        precision=model.novelty.precision,
        rest=model.novelty.rest,
        limits=model.novelty.limits,
        calibration=np.stack([known.doubt[task], known.share[task], known.error[task]]),
        anchored=model.anchored,
    )


def answer_in_numpy(values: Float32, anchor: Float, of: Prepared, out: Float) -> None:
    """Answer one row.

    Args:
        values: (F,) float32 features, without the anchor.
        anchor: (3,) float64, world, m.
        of: the model's arrays.
        out: (D + 4,) float64 to write into: targets, world, m; their spread, m; the novelty;
            the confidence; the expected error, m. Numbers that are not finite give
            confidence 0.
    """
    d, h, q, f = len(of.intercept), len(of.offset), len(of.curve_offset), len(of.centre)
    x = np.concatenate([values, anchor.astype(np.float32)])[:f]
    z = Scaling(of.centre, of.scale).of(x)
    along = z @ of.matrix
    bent = products(along[None, d + h : d + h + q] + of.curve_offset)[0]
    asked = (along[d : d + h] + of.offset).astype(np.float32)
    leaf = leaves_of(Trees(of.nodes, of.roots, len(of.values)), np.concatenate([x, asked])[None])[0]
    votes = of.values[leaf].astype(np.float64)
    for i in range(of.slopes.shape[1]):
        votes += np.float64(asked[i]) * of.slopes[leaf, i]
    mean = votes.mean(0)
    between = (votes * votes).mean() - (mean * mean).mean()
    spread = np.sqrt(max(float(between), 0.0) + of.variance[leaf].mean(dtype=np.float64))

    inside = along[d + h + q :]
    known = ((inside - of.mean) ** 2) @ of.precision
    score = (known + max(float(z @ z - inside @ inside), 0.0) * of.rest) / f
    novelty = score / np.exp(of.usual[leaf].mean(dtype=np.float64))

    targets = mean + along[:d] + of.intercept
    targets += bent @ of.bend
    if of.anchored:
        targets += np.tile(anchor, d // 3)
    out[:d] = targets
    low, high = of.limits
    familiar = 1.0 if novelty <= low else max(0.0, (high - novelty) / (high - low))
    knots, share, error = of.calibration
    sound = np.isfinite(targets).all() and np.isfinite(novelty)
    out[SPREAD], out[NOVELTY] = spread, novelty
    doubt = doubts(spread, score, novelty)
    out[CONFIDENCE] = familiar * np.interp(doubt, knots, share) if sound else 0.0
    out[ERROR] = np.interp(doubt, knots, error) if sound else np.inf


def fastest() -> Answer:
    """The compiled `answer` where numba is installed, the numpy one elsewhere."""
    try:
        from clothrf_forest.compiled import answer
    except ImportError:
        return answer_in_numpy
    compiled: Answer = answer
    return compiled
