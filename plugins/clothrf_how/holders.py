"""Who holds the cloth where: hands and grippers that touch it, told from it by their colour.

The targets follow from where the person's hands are, so the points at which something that is not
cloth touches the cloth are the most telling ones of the picture. An arm that only hides the cloth
stands off from it in depth and is no holder.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numba import njit
from numpy.typing import NDArray

from clothrf_core.rig import Rig
from clothrf_core.types import Float
from clothrf_how.foreground import Foreground
from clothrf_how.foreground_kernels import ODD
from clothrf_how.surface_kernels import surfaces

SLOTS = ("hand0", "hand1", "grasp0", "grasp1")
# Metres in depth between neighbouring pixels of one thing, and between a thing and the cloth that
# it holds: a fist stands off from a cloth that hangs down behind it. What is farther only occludes.
SMOOTH = 0.03
TOUCH = 0.08
# Metres from its end towards the cloth that count as a thing's tip.
TIP = 0.008
# Working pixels of a touch, and of the thing that touches, below which it is noise.
LEAST_TOUCH = 4
LEAST_AREA = 20
# Working pixels that may lie between a thing and the cloth that it holds.
GAP = 5
# A thing's pixels over its touching ones, at least: a fringe of the cloth's rim in the background's
# colour (colour and depth never match to the pixel) touches with every pixel it has.
LEAST_DEPTH = 3.0
# Metres from the measured grasp within which a thing touches, or ends, that is a gripper.
HELD = 0.06


@dataclass(frozen=True, slots=True, eq=False)
class Layout:
    """Which way the person stands.

    Attributes:
        towards_hands: (3,) unit vector from the robot's side to the person's, horizontal, world.
        across: (3,) unit vector from hand 0 to hand 1, horizontal, world.
        middle: (3,) between the rest hands, world, metres; None = the anchor is all there is.
    """

    towards_hands: Float
    across: Float
    middle: Float | None = None

    @classmethod
    def of(cls, rig: Rig) -> Layout:
        """From the rest corners."""
        hands, grasp = rig.rest_hands, rig.rest_grasp
        return cls(
            _level(hands.mean(axis=0) - grasp.mean(axis=0)),
            _level(hands[1] - hands[0]),
            hands.mean(axis=0),
        )

    @classmethod
    def facing(cls, T_world_camera: Float) -> Layout:
        """Without a rig: the person stands behind the camera, hand 0 on the picture's left."""
        return cls(_level(-T_world_camera[:3, 2]), _level(T_world_camera[:3, 0]))


@dataclass(frozen=True, slots=True, eq=False)
class Holders:
    """Touching points, metres from the anchor, world axes.

    Attributes:
        seen: (4,) bool, in the order of `SLOTS`.
        points: (4, 3) float64 middle of the touch; zeros where not seen.
        tips: (4, 3) float64 end of what touches that is turned to the cloth.
        away: (4, 3) float64 from there to the middle of what touches; zeros where not seen.
        share: (4,) how much of the picture it fills.
        foreign: the same of everything before the background that is neither cloth nor holder.
    """

    seen: NDArray[np.bool_]
    points: Float
    tips: Float
    away: Float
    share: Float
    foreign: float


def find_holders(
    area: Foreground, anchor: Float, layout: Layout, grasp: Float | None = None
) -> Holders:
    """The two largest things on the person's side and on the robot's, in the order of `across`.

    Args:
        area: the cloth.
        anchor: (3,) world, m.
        layout: which way the person stands.
        grasp: (2, 3) where the robot says its grippers are, m from the anchor; None or NaN: not
            known. What is there is that gripper, whatever it looks like: in a twist the grippers
            stand above each other, and a gripper in front of the cloth looks like a hand.
    """
    seen = np.zeros(4, bool)
    points, tips, away = np.zeros((4, 3)), np.zeros((4, 3)), np.zeros((4, 3))
    share = np.zeros(4)
    label, size = surfaces(area.measured, area.state, SMOOTH, ODD, area.roi)
    start = (area.view.camera.T_world_camera[:3, 3] - anchor).astype(np.float32)
    table, boxes = touches(
        label, size, area.mask, area.depth, area.measured, area.view.directions, start, TOUCH,
        area.roi,
    )  # fmt: skip
    touching, whole = table[:, 0], table[:, 4]
    things = np.flatnonzero(
        (touching >= LEAST_TOUCH) & (whole >= LEAST_AREA) & (whole >= LEAST_DEPTH * touching)
    )
    table = table[things]
    middle = table[:, 1:4] / table[:, :1]
    reach = table[:, 5:8] / table[:, 4:5] - middle
    end = np.zeros_like(middle)
    for i, number in enumerate(things):
        end[i] = tip(
            label, int(number), boxes[number], area.measured, area.view.directions, start, reach[i]
        )
    known = None if grasp is None or not np.isfinite(grasp).all() else grasp
    # One hand alone is the one on whose side of the rest pose it is.
    centre = np.zeros(3) if layout.middle is None else layout.middle - anchor
    for slot, which in slots(middle, end, reach, table[:, 4], layout, centre, known).items():
        seen[slot], points[slot], away[slot] = True, middle[which], reach[which]
        tips[slot] = end[which]
        share[slot] = size[things[which]] / label.size
    foreign = float(size[1:].sum() / label.size - share.sum())
    return Holders(seen, points, tips, away, share, foreign)


def slots(
    middle: Float,
    end: Float,
    reach: Float,
    size: Float,
    layout: Layout,
    centre: Float,
    grasp: Float | None,
) -> dict[int, int]:
    """Which of n things is in which of the `SLOTS`.

    Args:
        middle: (n, 3) of each thing's touch, m from the anchor.
        end: (n, 3) of each thing, turned to the cloth.
        reach: (n, 3) from the touch to the middle of the thing.
        size: (n,) pixels.
        layout: which way the person stands.
        centre: (3,) between the rest hands.
        grasp: (2, 3) the measured grippers, if known.
    """
    result: dict[int, int] = {}
    free = np.ones(len(middle), bool)
    origin = np.zeros(3)
    if grasp is not None:
        origin = grasp.mean(0)
        apart = np.minimum(
            ((middle[:, None] - grasp) ** 2).sum(2), ((end[:, None] - grasp) ** 2).sum(2)
        ).ravel()
        for pair in np.argsort(apart, kind="stable").tolist():
            which, i = divmod(pair, 2)
            if apart[pair] < HELD * HELD and free[which] and 2 + i not in result:
                result[2 + i] = which
                free[which] = False
    # A thing is the person's if it points, and lies, to the person's side.
    by_person = (middle - origin + 2.0 * reach) @ layout.towards_hands > 0.0
    groups = [(0, by_person & free)]
    if grasp is None:
        groups.append((2, ~by_person))
    for first, wanted in groups:
        group = np.flatnonzero(wanted)
        largest = group[np.argsort(-size[group], kind="stable")[:2]]
        order = largest[np.argsort(middle[largest] @ layout.across, kind="stable")]
        places = [first, first + 1]
        if order.size == 1:
            places = [first + int((middle[order[0]] - centre) @ layout.across > 0.0)]
        result.update(zip(places, (int(which) for which in order), strict=False))
    return result


# Scalars and one sweep of the thing's own box: small arrays made for every pixel were a fifth of
# the time of a collected sample (by the profiler).
@njit(cache=True, nogil=True)
def tip(
    label: NDArray[np.int32],
    which: int,
    box: NDArray[np.int64],
    measured: NDArray[np.float32],
    directions: NDArray[np.float32],
    start: NDArray[np.float32],
    away: NDArray[np.float64],
) -> NDArray[np.float64]:
    """(3,) mean of the points of thing `which` within `TIP` of its end against `away`.

    `box` is (x0, y0, x1, y1), half-open, and holds every pixel of the thing.
    """
    x0, y0, x1, y1 = box
    a, b, c = away[0], away[1], away[2]
    length = np.sqrt(a * a + b * b + c * c) + 1e-9
    reach = np.empty((y1 - y0, x1 - x0))
    least = 1e9
    for y in range(y0, y1):
        for x in range(x0, x1):
            if label[y, x] == which:
                d = measured[y, x]
                along = 0.0
                along += (start[0] + d * directions[0, y, x]) * a
                along += (start[1] + d * directions[1, y, x]) * b
                along += (start[2] + d * directions[2, y, x]) * c
                reach[y - y0, x - x0] = along / length
                least = min(least, along / length)
    total = np.zeros(3)
    count = 0
    for y in range(y0, y1):
        for x in range(x0, x1):
            if label[y, x] == which and reach[y - y0, x - x0] <= least + TIP:
                d = measured[y, x]
                for axis in range(3):
                    total[axis] += start[axis] + d * directions[axis, y, x]
                count += 1
    return total / max(count, 1)


@njit(cache=True, nogil=True)
def touches(
    label: NDArray[np.int32],
    size: NDArray[np.int32],
    mask: NDArray[np.bool_],
    depth: NDArray[np.float32],
    measured: NDArray[np.float32],
    directions: NDArray[np.float32],
    start: NDArray[np.float32],
    touch: float,
    roi: tuple[int, int, int, int],
) -> tuple[NDArray[np.float64], NDArray[np.int64]]:
    """(labels + 1, 8): touching pixels, the sum of their cloth points, area, the sum of all points.

    And (labels + 1, 4): the half-open box (x0, y0, x1, y1) of each label's pixels. A pixel of a
    thing touches the cloth if, in one of the four directions, the next pixel of a thing or the
    cloth is cloth, at most `GAP` farther and within `touch` of its depth; the point counted is the
    cloth's. All of it lies in `roi`.
    """
    h, w = label.shape
    table = np.zeros((size.size, 8))
    boxes = np.zeros((size.size, 4), np.int64)
    boxes[:, 0] = w
    boxes[:, 1] = h
    limit = np.float32(touch)
    x0, y0, x1, y1 = roi
    for y in range(y0, y1):
        for x in range(x0, x1):
            n = label[y, x]
            if n == 0:
                continue
            d = measured[y, x]
            table[n, 4] += 1.0
            boxes[n, 0] = min(boxes[n, 0], x)
            boxes[n, 1] = min(boxes[n, 1], y)
            boxes[n, 2] = max(boxes[n, 2], x + 1)
            boxes[n, 3] = max(boxes[n, 3], y + 1)
            for axis in range(3):
                table[n, 5 + axis] += start[axis] + d * directions[axis, y, x]
            for k in range(4):
                down = 1 if k == 0 else (-1 if k == 1 else 0)
                right = 1 if k == 2 else (-1 if k == 3 else 0)
                j, i = y + down, x + right
                gap = 0
                # Next to an edge depth sensors see nothing, or specks of anything.
                while (
                    gap < GAP
                    and 0 <= j < h
                    and 0 <= i < w
                    and not mask[j, i]
                    and (label[j, i] == 0 or size[label[j, i]] < LEAST_AREA)
                ):
                    j, i, gap = j + down, i + right, gap + 1
                if not (0 <= j < h and 0 <= i < w) or not mask[j, i]:
                    continue
                c = depth[j, i]
                if abs(c - d) < limit:
                    table[n, 0] += 1.0
                    for axis in range(3):
                        table[n, 1 + axis] += start[axis] + c * directions[axis, j, i]
    return table, boxes


def _level(vector: Float) -> Float:
    flat = np.array([vector[0], vector[1], 0.0])
    length = float(np.linalg.norm(flat))
    return flat / length if length > 1e-9 else np.array([1.0, 0.0, 0.0])
