"""Oblique splits: what the linear base says of a row, offered to every node as a few columns.

A tree that may only ask for one feature at a time needs many questions for a smooth direction; the
principal directions of the base's own answers are the directions that matter for the action.
While training, a row's columns come from the base that did not see its roll-out.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from clothrf_core.types import Float, Float32
from clothrf_forest.ridge import Base


@dataclass(frozen=True, slots=True)
class Projections:
    """h linear functions of standardised features: ``z @ axes + offset``.

    Attributes:
        axes: (F, h) float32.
        offset: (h,) float64.
    """

    axes: Float32
    offset: Float


def principal_axes(targets: Float, *, share: float = 0.999, most: int = 8) -> tuple[Float, Float]:
    """Mean (D,) and scaled directions (D, d) of (N, D) targets.

    ``(targets - mean) @ axes`` holds `share` of the variance in at most `most` columns, and its
    total variance is 1.
    """
    mean = targets.mean(0)
    centred = targets - mean
    variance, axes = np.linalg.eigh(centred.T @ centred / len(centred))
    variance, axes = np.maximum(variance[::-1], 0.0), axes[:, ::-1]
    total = float(variance.sum())
    if total < 1e-30:
        return mean, np.zeros((len(mean), 1))
    held = np.cumsum(variance) / total
    d = min(int(np.searchsorted(held, share)) + 1, most, len(variance))
    return mean, axes[:, :d] / np.sqrt(float(variance[:d].sum()))


def offered(base: Base) -> tuple[Projections, Float32]:
    """The projections of `base`, and their (N, h) held-out values on the training rows."""
    mean, axes = principal_axes(base.held_out)
    projections = Projections(
        axes=(base.linear.coef @ axes).astype(np.float32),
        offset=(base.linear.intercept - mean) @ axes,
    )
    return projections, ((base.held_out - mean) @ axes).astype(np.float32)


def no_projections(num_features: int) -> Projections:
    """None of them."""
    return Projections(np.zeros((num_features, 0), np.float32), np.zeros(0))
