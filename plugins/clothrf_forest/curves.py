"""What a straight line cannot say: products of the few directions that matter most.

Corners of a turned cloth are products of lengths and directions, so a linear base leaves most of
its error to the trees, which pay for a smooth surface with many leaves. Here the base is also told
``u_i u_j`` of a few directions u, the `telling` ones (a response surface: Box and Wilson 1951).
Each u is clipped, so that an unusual picture cannot send a square far out. A product of two
directions that bend the answers little is trusted little: the penalties are those of the
quadratic kernel that named the directions.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from clothrf_core.types import Float, Float32
from clothrf_forest.binning import chunks
from clothrf_forest.ridge import Design, Index, Scaling, spread

# Standard deviations at which a direction is clipped.
REACH = 4.0
# Root of how much all features together are trusted beside the square of the first direction.
STRAIGHT = 5.0


@dataclass(frozen=True, slots=True)
class Curves:
    """P = q (q + 1) / 2 products of q directions.

    Attributes:
        axes: (F, q) float32; standardised features to directions of variance 1.
        offset: (q,) float64 added to them.
        by: how the products are standardised.
    """

    axes: Float32
    offset: Float
    by: Scaling

    @property
    def count(self) -> int:
        """P."""
        return len(self.by.centre)

    def of(self, z: Float) -> Float:
        """(n, P) float64 standardised products of (n, F) standardised features."""
        return self.by.of(products(z @ self.axes + self.offset), np.inf)


def products(u: Float) -> Float:
    """(n, P) products of (n, q) directions, in the order of the upper triangle."""
    q = u.shape[1]
    near = np.clip(u, -REACH, REACH)
    first, second = np.triu_indices(q)
    found: Float = near[:, first] * near[:, second]
    return found


def no_curves(num_features: int) -> Curves:
    """None of them."""
    nothing = np.zeros(0, np.float32)
    return Curves(np.zeros((num_features, 0), np.float32), np.zeros(0), Scaling(nothing, nothing))


def fit_curves(design: Design, directions: Float) -> Curves:
    """Products of the (F, q) `directions`, scaled by what the rows of `design` show."""
    n, q = len(design), directions.shape[1]
    total, square = np.zeros(q), np.zeros(q)
    for rows in chunks(n):
        along = design.of(rows) @ directions
        total += along.sum(0)
        square += (along**2).sum(0)
    mean = total / n
    scale = 1.0 / np.sqrt(np.maximum(square / n - mean**2, 1e-12))
    axes = (directions * scale).astype(np.float32)
    offset = -mean * scale
    by = spread(lambda rows: products(design.of(rows) @ axes + offset), n, q * (q + 1) // 2)
    return Curves(axes, offset, by)


def trusted(weight: Float, reach: Float) -> Float:
    """(F + P,) how far the columns of a `Curved` design are trusted; mean square 1.

    Args:
        weight: (F,) of the features.
        reach: (q,) of the directions, the greatest 1.
    """
    first, second = np.triu_indices(len(reach))
    straight = STRAIGHT * weight / max(float(np.linalg.norm(weight)), 1e-300)
    found = np.concatenate([straight, reach[first] * reach[second]])
    found /= max(float(np.sqrt((found**2).mean())), 1e-300)
    return found


@dataclass(frozen=True, slots=True)
class Curved(Design):
    """Standardised features and, behind them, their products.

    Attributes:
        straight: the features.
        curves: the products.
    """

    straight: Design
    curves: Curves

    def __len__(self) -> int:
        return len(self.straight)

    @property
    def width(self) -> int:
        """F + P."""
        return self.straight.width + self.curves.count

    def of(self, rows: Index) -> Float:
        """(n, F + P) float64."""
        z = self.straight.of(rows)
        return np.concatenate([z, self.curves.of(z)], axis=1)
