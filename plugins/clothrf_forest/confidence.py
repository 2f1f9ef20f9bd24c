"""Confidence that means something: the chance that the error is below a tolerance.

The doubt about an answer is its spread (disagreement of trees, scatter inside leaves) times how
far out the picture lies, times the square of its novelty. The first two foretell the error (rank
correlation 0.68 on SR300 noise, the spread alone 0.33), the last tells strange pictures apart. It
is compared with the real error of out-of-bag rows, whose novelty is judged by a model of other
roll-outs. Rows are sorted by doubt and cut into equal bins; the share of small errors per bin is
made to fall with the doubt (pool adjacent violators, Ayer et al. 1955), and acting interpolates
between the bins' centres.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from clothrf_core.types import Float

BINS = 16


@dataclass(frozen=True, slots=True)
class Calibration:
    """From doubt to confidence, per task.

    Attributes:
        doubt: (T, B) float64 increasing, m.
        share: (T, B) float64 falling, P(RMS error per coordinate < tolerance).
        error: (T, B) float64 rising, expected RMS error per coordinate, m.
    """

    doubt: Float
    share: Float
    error: Float


def doubts(spread: Float, score: Float, novelty: Float) -> Float:
    """The doubt about answers, m.

    Args:
        spread: scatter of the leaves and of the trees, m.
        score: how far out the picture lies.
        novelty: the same over what its leaves are used to.
    """
    found: Float = spread * np.maximum(score, 0.0) * novelty**2
    return found


def calibrated(doubt: Float, error: Float, tolerance: float) -> Calibration:
    """Fit on (M, T) doubts and RMS errors of rows that were not trained on.

    Without rows nothing is known, and the confidence is 0.5 everywhere.
    """
    tasks = doubt.shape[1]
    if len(doubt) == 0:
        nothing = np.zeros((tasks, BINS))
        return Calibration(nothing, nothing + 0.5, nothing + tolerance)
    centres, shares, errors = (np.empty((tasks, BINS)) for _ in range(3))
    cut = np.linspace(0, len(doubt), BINS + 1)
    for t in range(tasks):
        order = np.argsort(doubt[:, t], kind="stable")
        s, e = doubt[order, t], error[order, t]
        for b in range(BINS):
            low = min(int(cut[b]), len(s) - 1)
            part = slice(low, max(int(cut[b + 1]), low + 1))
            centres[t, b] = s[part].mean()
            # One imagined row on each side: no bin is ever certain (Laplace's rule).
            shares[t, b] = ((e[part] < tolerance).sum() + 1.0) / (len(e[part]) + 2.0)
            errors[t, b] = e[part].mean()
        shares[t] = -rising(-shares[t])
        errors[t] = rising(errors[t])
    return Calibration(np.maximum.accumulate(centres, axis=1), shares, errors)


def rising(values: Float) -> Float:
    """The non-decreasing sequence nearest to `values` in least squares."""
    means: list[float] = []
    sizes: list[int] = []
    for value in values:
        means.append(float(value))
        sizes.append(1)
        while len(means) > 1 and means[-2] > means[-1]:
            mean, size = means.pop(), sizes.pop()
            means[-1] = (means[-1] * sizes[-1] + mean * size) / (sizes[-1] + size)
            sizes[-1] += size
    return np.repeat(means, sizes)
