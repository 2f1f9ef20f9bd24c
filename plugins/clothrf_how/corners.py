"""The four corners of the cloth, and the edges between them: from them the targets follow.

The experts' targets are functions of the person's two corners alone: straight, for example, is
``hand + length * c`` with c the horizontal normal of the hands' edge. A linear model cannot make c
of the corners, so the edge's normals are features too. A corner is, in this order, where a holder
touches the cloth (`holders`), or the outermost point of the cloth towards that corner's side.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numba import njit
from numpy.typing import NDArray

from clothrf_core.types import Float, Float32
from clothrf_how.cloud import Cloud
from clothrf_how.holders import SLOTS, Holders, Layout

# Elevation of the direction in which a corner is outermost, degrees. Held corners are higher than
# the cloth between them; 20-40 found the hands best (median 12-15 mm, hidden ones aside).
ELEVATION = 20.0
# Metres; points this close to the outermost one are averaged.
BAND = 0.004
EDGE = ("cx", "cy", "ground", "rise", "nx", "ny", "nz", "length")


@dataclass(frozen=True, slots=True, eq=False)
class Corners:
    """The corners in the order of `SLOTS`, metres from the anchor, world axes.

    Attributes:
        seen: (4,) bool, whether a holder was found.
        points: (4, 3) touch, or outermost point.
        tips: (4, 3) tip of the holder, or outermost point.
        away: (4, 3) from the touch to the middle of the holder; zeros where none was found.
        share: (4,) how much of the picture the holder fills.
        foreign: how much of it something else does that is not cloth either.
    """

    seen: NDArray[np.bool_]
    points: Float
    tips: Float
    away: Float
    share: Float
    foreign: float


def find_corners(
    cloud: Cloud, holders: Holders, layout: Layout, grasp: Float | None = None
) -> Corners:
    """Corners from holders, and from the cloth's outermost points where there is none.

    The robot's two are where it measures them, (2, 3) `grasp`, m from the anchor, if that is known.
    """
    points, tips = holders.points.copy(), holders.tips.copy()
    asked = ~holders.seen
    if grasp is not None and np.isfinite(grasp).all():
        points[2:], tips[2:] = grasp, grasp
        asked[2:] = False
    if asked.any():
        outermost = farthest(cloud.points, cloud.mask, outward(layout)[asked], np.float32(BAND))
        points[asked], tips[asked] = outermost, outermost
    return Corners(holders.seen, points, tips, holders.away, holders.share, holders.foreign)


def outward(layout: Layout) -> Float32:
    """(4, 3) float32 unit vectors, world: in which direction each corner is outermost."""
    rise = np.radians(ELEVATION)
    ways = []
    for towards in (1.0, -1.0):
        for side in (-1.0, 1.0):
            flat = towards * layout.towards_hands + side * layout.across
            flat = flat / max(float(np.linalg.norm(flat)), 1e-9)
            ways.append(np.cos(rise) * flat + np.sin(rise) * np.array([0.0, 0.0, 1.0]))
    return np.array(ways, np.float32)


def corners_names() -> tuple[str, ...]:
    """77 names."""
    names = [f"corners_{s}_seen" for s in SLOTS]
    for part in ("point", "tip", "away"):
        names += [f"corners_{s}_{part}_{a}" for s in SLOTS for a in "xyz"]
    names += [f"corners_{e}_{x}" for e in ("hands", "tips", "grasp") for x in EDGE]
    names += [f"corners_side{i}_{a}" for i in range(2) for a in (*"xyz", "length")]
    names += [*(f"corners_{s}_share" for s in SLOTS), "corners_foreign"]
    return tuple(names)


def corners(found: Corners) -> Float32:
    """(77,) float32: corners, the edges between them, the sides from hand to grasp, who is there.

    The shares are square roots, so that they grow like lengths.
    """
    sides = found.points[2:] - found.points[:2]
    lengths = np.linalg.norm(sides, axis=1, keepdims=True)
    return np.concatenate(
        [
            found.seen,
            found.points.ravel(),
            found.tips.ravel(),
            found.away.ravel(),
            edge(found.points[0], found.points[1]),
            edge(found.tips[0], found.tips[1]),
            edge(found.points[2], found.points[3]),
            np.concatenate([sides, lengths], axis=1).ravel(),
            np.sqrt(found.share),
            [np.sqrt(max(found.foreign, 0.0))],
        ]
    ).astype(np.float32)


def cases_names() -> tuple[str, ...]:
    """4 x 35 names; case 0 sees no hand, 1 hand 1, 2 hand 0, 3 both."""
    core = [f"{p}{i}_{a}" for p in ("point", "tip", "away") for i in range(2) for a in "xyz"]
    core += [f"{e}_{x}" for e in ("hands", "tips") for x in EDGE]
    return tuple(f"cases_{k}_{name}" for k in range(4) for name in ("is", *core))


def cases(found: Corners) -> Float32:
    """(140,) float32: the hands' numbers once for each case of which hands are in the picture.

    Zeros but for the case at hand, so that a linear model has its own coefficients in each: what a
    seen corner says and what an outermost point says in its stead are different things.
    """
    core = np.concatenate(
        [
            np.ones(1),
            found.points[:2].ravel(),
            found.tips[:2].ravel(),
            found.away[:2].ravel(),
            edge(found.points[0], found.points[1]),
            edge(found.tips[0], found.tips[1]),
        ]
    )
    values = np.zeros((4, core.size), np.float32)
    values[2 * int(found.seen[0]) + int(found.seen[1])] = core
    return values.ravel()


@njit(cache=True, nogil=True)
def edge(start: NDArray[np.float64], end: NDArray[np.float64]) -> NDArray[np.float64]:
    """(8,): horizontal normal (2), length on the ground, rise, second normal (3), length.

    With d the edge and z up: c = z x d / |z x d|, n = d x c / |d|, as the experts use them.
    """
    d = end - start
    ground = np.hypot(d[0], d[1])
    length = np.sqrt(d[0] * d[0] + d[1] * d[1] + d[2] * d[2])
    cx, cy = (-d[1] / ground, d[0] / ground) if ground > 1e-6 else (0.0, 0.0)
    u = d / length if length > 1e-6 else np.zeros(3)
    nx, ny, nz = -u[2] * cy, u[2] * cx, u[0] * cy - u[1] * cx
    return np.array([cx, cy, ground, d[2], nx, ny, nz, length])


# Points are never NaN, so a maximum may be taken in any order: vector code. Only the rows that come
# close to the outermost one are looked at again.
@njit(cache=True, nogil=True, fastmath={"contract", "nnan", "nsz", "reassoc"})
def farthest(
    points: NDArray[np.float32],
    mask: NDArray[np.bool_],
    ways: NDArray[np.float32],
    band: np.float32,
) -> NDArray[np.float64]:
    """(K, 3) mean of the points within `band` metres of the outermost one of each (K, 3) way."""
    _, h, w = points.shape
    many = len(ways)
    result = np.zeros((many, 3))
    outermost = np.empty((many, h), np.float32)
    lowest = np.float32(-1e9)
    for y in range(h):
        px, py, pz, inside = points[0, y], points[1, y], points[2, y], mask[y]
        for k in range(many):
            a, b, c = ways[k, 0], ways[k, 1], ways[k, 2]
            best = lowest
            for x in range(w):
                value = a * px[x] + b * py[x] + c * pz[x]
                value = value if inside[x] else lowest
                best = value if value > best else best
            outermost[k, y] = best
    for k in range(many):
        a, b, c = ways[k, 0], ways[k, 1], ways[k, 2]
        limit = outermost[k].max() - band
        count = 0
        for y in range(h):
            if outermost[k, y] < limit:
                continue
            px, py, pz, inside = points[0, y], points[1, y], points[2, y], mask[y]
            for x in range(w):
                if inside[x] and a * px[x] + b * py[x] + c * pz[x] >= limit:
                    count += 1
                    for axis in range(3):
                        result[k, axis] += points[axis, y, x]
        result[k] /= max(count, 1)
    return result
