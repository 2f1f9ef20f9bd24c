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
from clothrf_how.foreground_kernels import GROWN, ODD
from clothrf_how.surface_kernels import surfaces

SLOTS = ("hand0", "hand1", "grasp0", "grasp1")
# Metres in depth between neighbouring pixels of one thing, and between a thing and the cloth that
# it holds: a fist stands off from a cloth that hangs down behind it. What is farther only occludes.
SMOOTH = 0.03
TOUCH = 0.08
# The same where the cloth's depth is not measured but continued from what is: the thing's own depth
# counts there.
LOST = 0.3
# Metres from its end towards the cloth that count as a thing's tip.
TIP = 0.008
# Working pixels of a touch, and of the thing that touches, below which it is noise.
LEAST_TOUCH = 4
LEAST_AREA = 20
# Working pixels that may lie between a thing and the cloth that it holds.
GAP = 12
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
        label, size, area.mask, area.depth, area.measured, area.state, area.view.directions,
        start, TOUCH, area.roi, area.box,
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
    known = np.zeros((0, 3)) if grasp is None or not np.isfinite(grasp).all() else grasp
    centre = np.zeros(3) if layout.middle is None else layout.middle - anchor
    found = slots(
        middle, end, reach, table[:, 4], layout.towards_hands, layout.across, centre, known
    )
    for slot, which in enumerate(found):
        if which < 0:
            continue
        seen[slot], points[slot], away[slot] = True, middle[which], reach[which]
        tips[slot] = end[which]
        share[slot] = size[things[which]] / label.size
    foreign = float(size[1:].sum() / label.size - share.sum())
    return Holders(seen, points, tips, away, share, foreign)


@njit(cache=True, nogil=True)
def slots(
    middle: NDArray[np.float64],
    end: NDArray[np.float64],
    reach: NDArray[np.float64],
    size: NDArray[np.float64],
    towards_hands: NDArray[np.float64],
    across: NDArray[np.float64],
    centre: NDArray[np.float64],
    grasp: NDArray[np.float64],
) -> NDArray[np.int64]:
    """(4,) which of n things is in which of the `SLOTS`, -1 = none.

    Args:
        middle: (n, 3) of each thing's touch, m from the anchor.
        end: (n, 3) of each thing, turned to the cloth.
        reach: (n, 3) from the touch to the middle of the thing.
        size: (n,) pixels.
        towards_hands: (3,) of the layout.
        across: (3,) of the layout.
        centre: (3,) between the rest hands.
        grasp: (2, 3) the measured grippers, or (0, 3) if they are not known.
    """
    n = len(middle)
    result = np.full(4, -1)
    free = np.ones(n, np.bool_)
    origin = np.zeros(3)
    for i in range(len(grasp)):
        origin += grasp[i] / len(grasp)
    # The nearest of all pairs of a thing and a gripper, then the next.
    for _ in range(len(grasp)):
        nearest, which, slot = HELD * HELD, -1, -1
        for thing in range(n):
            for i in range(len(grasp)):
                if free[thing] and result[2 + i] < 0:
                    apart = min(_square(middle[thing], grasp[i]), _square(end[thing], grasp[i]))
                    if apart < nearest:
                        nearest, which, slot = apart, thing, i
        if which >= 0:
            result[2 + slot] = which
            free[which] = False
    for first in range(0, 4 if len(grasp) == 0 else 2, 2):
        # A thing is the person's if it points, and lies, to the person's side.
        one = two = -1
        for thing in range(n):
            side = _dot(middle[thing] - origin + 2.0 * reach[thing], towards_hands)
            if not free[thing] or (side > 0.0) != (first == 0):
                continue
            if one < 0 or size[thing] > size[one]:
                one, two = thing, one
            elif two < 0 or size[thing] > size[two]:
                two = thing
        if two >= 0:
            if _dot(middle[two], across) < _dot(middle[one], across):
                one, two = two, one
            result[first], result[first + 1] = one, two
        elif one >= 0:
            # One hand alone is the one on whose side of the rest pose it is.
            right = _dot(middle[one] - centre, across) > 0.0
            result[first + (1 if right else 0)] = one
    return result


@njit(cache=True, nogil=True)
def _dot(a: NDArray[np.float64], b: NDArray[np.float64]) -> float:
    return float(a[0] * b[0] + a[1] * b[1] + a[2] * b[2])


@njit(cache=True, nogil=True)
def _square(a: NDArray[np.float64], b: NDArray[np.float64]) -> float:
    d = a - b
    return _dot(d, d)


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


# Run by run: the sums of a run are vector code, and only its ends and what lies above and below
# another thing are looked at one by one.
@njit(cache=True, nogil=True, fastmath={"contract", "reassoc", "nsz"})
def touches(
    label: NDArray[np.int32],
    size: NDArray[np.int32],
    mask: NDArray[np.bool_],
    depth: NDArray[np.float32],
    measured: NDArray[np.float32],
    state: NDArray[np.uint8],
    directions: NDArray[np.float32],
    start: NDArray[np.float32],
    touch: float,
    roi: tuple[int, int, int, int],
    cloth: tuple[int, int, int, int],
) -> tuple[NDArray[np.float64], NDArray[np.int64]]:
    """(labels + 1, 8): touching pixels, the sum of their cloth points, area, the sum of all points.

    And (labels + 1, 4): the half-open box (x0, y0, x1, y1) of each label's pixels. A pixel of a
    thing touches the cloth if, in one of the four directions, the next pixel of a thing or the
    cloth is cloth, at most `GAP` farther and within `touch` of its depth; the point counted is the
    cloth's. All of it lies in `roi`, the cloth in the box `cloth`; things smaller than `LEAST_AREA`
    are left out.
    """
    h, w = label.shape
    table = np.zeros((size.size, 8))
    boxes = np.zeros((size.size, 4), np.int64)
    boxes[:, 0] = w
    boxes[:, 1] = h
    limit, lost = np.float32(touch), np.float32(LOST)
    x0, y0, x1, y1 = roi
    left, top, right, bottom = cloth
    for y in range(y0, y1):
        line = label[y]
        some = np.int32(0)
        for x in range(x0, x1):
            some |= line[x]
        if some == 0:
            continue
        end = x0
        while end < x1:
            begin = end
            n = line[begin]
            while end < x1 and line[end] == n:
                end += 1
            if n == 0 or size[n] < LEAST_AREA:
                continue
            box = boxes[n]
            box[0], box[1] = min(box[0], begin), min(box[1], y)
            box[2], box[3] = max(box[2], end), max(box[3], y + 1)
            table[n, 4] += end - begin
            for axis in range(3):
                row, ray = measured[y, begin:end], directions[axis, y, begin:end]
                total = np.float32(0.0)
                for i in range(end - begin):
                    total += row[i] * ray[i]
                table[n, 5 + axis] += float(total) + (end - begin) * float(start[axis])
            given = (
                label, size, mask, depth, measured, state, directions, start, limit, lost, table[n],
            )  # fmt: skip
            # Nothing is met where the cloth does not reach.
            if top <= y < bottom:
                if left < begin <= right + GAP:
                    _touch(y, begin, 0, -1, *given)
                if left <= end + GAP and end < right:
                    _touch(y, end - 1, 0, 1, *given)
            up = y > 0 and top < y <= bottom + GAP
            down = y + 1 < h and top <= y + 1 + GAP and y + 1 < bottom
            for x in range(max(begin, left), min(end, right)):
                if up and label[y - 1, x] != n:
                    _touch(y, x, -1, 0, *given)
                if down and label[y + 1, x] != n:
                    _touch(y, x, 1, 0, *given)
    return table, boxes


@njit(cache=True, nogil=True)
def _touch(
    y: int,
    x: int,
    down: int,
    right: int,
    label: NDArray[np.int32],
    size: NDArray[np.int32],
    mask: NDArray[np.bool_],
    depth: NDArray[np.float32],
    measured: NDArray[np.float32],
    state: NDArray[np.uint8],
    directions: NDArray[np.float32],
    start: NDArray[np.float32],
    limit: np.float32,
    lost: np.float32,
    row: NDArray[np.float64],
) -> None:
    """Add to a thing's row of the table where its pixel (y, x) touches the cloth that way."""
    h, w = label.shape
    j, i, gap = y + down, x + right, 0
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
        return
    c, d = depth[j, i], measured[y, x]
    if state[j, i] == GROWN and abs(c - d) < lost:
        c = d
    if abs(c - d) < limit:
        row[0] += 1.0
        for axis in range(3):
            row[1 + axis] += start[axis] + c * directions[axis, j, i]


def _level(vector: Float) -> Float:
    flat = np.array([vector[0], vector[1], 0.0])
    length = float(np.linalg.norm(flat))
    return flat / length if length > 1e-9 else np.array([1.0, 0.0, 0.0])
