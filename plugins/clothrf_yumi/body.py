"""Everything that may touch: capsules around the links, boxes around the body, the table.

Distances and normals are coal's. Most pairs are far apart most of the time, so a pair is measured
only if the spheres around its bodies come near. The capsules hull whole links with the air beside
them: in the controller's calibration posture, arms folded against the head, they touch it.
"""

from __future__ import annotations

from dataclasses import dataclass

import coal
import numpy as np
import pinocchio as pin
from numpy.typing import NDArray

from clothrf_core.types import Float
from clothrf_yumi.irb14000 import (
    AXES,
    BODY,
    FINGERS,
    FLANGE_M,
    GRIPPER_BODY,
    SIDES,
    Box,
    Capsule,
    joint_name,
)
from clothrf_yumi.kinematics import Kinematics

LINKS = (*(f"link {axis.number}" for axis in AXES), "gripper", "fingers")

# In one arm only these can meet; the joint limits keep the others apart.
WITHIN_ARM = {
    "link 1": ("link 3", "link 4", "link 5", "link 6", "gripper", "fingers"),
    "link 2": ("link 4", "link 5", "link 6", "gripper", "fingers"),
}
FIXED_LINKS = ("link 1", "link 2")  # too near the body to meet anything else of it


@dataclass(frozen=True, slots=True, eq=False)
class Near:
    """Pairs of bodies that are close, K of them.

    Attributes:
        distance: (K,) float64, metres; negative in penetration.
        rows: (K, 14) float64, derivative of `distance` by the joints.
    """

    distance: Float
    rows: Float


@dataclass(frozen=True, slots=True, eq=False)
class _Group:
    """Pairs that tend to be near or far together, with Pinocchio's work space for them."""

    pairs: list[tuple[int, int]]
    bodies: NDArray[np.intp]
    geometry: pin.GeometryModel
    data: pin.GeometryData


class Body:
    """Distances between the parts of the robot and to the table; shares `Kinematics`' work space.

    Body and table are padded, so that one threshold keeps the arms farther from them than from
    each other. Pairs stand in groups because Pinocchio names the nearest pair of a group for
    nothing, while reading all distances from Python takes twice as long as computing them. Each
    group remembers its least distance: until the joints have turned far enough to have used it up,
    it need not be measured again. The answers are the same as without that memory.
    """

    def __init__(self, kinematics: Kinematics, *, table_height: float, padding: float) -> None:
        self._kinematics = kinematics
        self._names: list[str] = []
        self._capsules: list[tuple[int, Float, Float, float]] = []
        shapes = pin.GeometryModel()
        for side in SIDES:
            for axis in AXES:
                name = f"{side} link {axis.number}"
                self._add_capsule(shapes, name, axis.number, side, axis.link)
            for name, capsule in (("gripper", GRIPPER_BODY), ("fingers", FINGERS)):
                self._add_capsule(shapes, f"{side} {name}", 6, side, capsule, lift=FLANGE_M)
        for box in (*BODY, Box("table", (-2, -2, table_height - 0.5), (2, 2, table_height))):
            low, high = np.array(box.low) - padding, np.array(box.high) + padding
            placement = pin.SE3(np.eye(3), (low + high) / 2.0)
            self._names.append(box.name)
            shapes.addGeometryObject(
                pin.GeometryObject(box.name, 0, placement, coal.Box(*(high - low)))
            )
        self._groups = [_group(shapes, pairs) for pairs in _pair_groups()]
        self._least = np.full(len(self._groups), -np.inf)
        self._least_at = np.zeros((len(self._groups), 2 * len(AXES)))
        self._lever = _levers()

    def _add_capsule(
        self,
        shapes: pin.GeometryModel,
        name: str,
        number: int,
        side: str,
        capsule: Capsule,
        *,
        lift: float = 0.0,
    ) -> None:
        start = np.array(capsule.start) + [0.0, 0.0, lift]
        end = np.array(capsule.end) + [0.0, 0.0, lift]
        length = float(np.linalg.norm(end - start))
        turn = pin.Quaternion.FromTwoVectors(np.array([0.0, 0.0, 1.0]), (end - start) / length)
        joint = self._kinematics.model.getJointId(joint_name(number, side))
        placement = pin.SE3(turn.matrix(), (start + end) / 2.0)
        shape = coal.Capsule(capsule.radius, length)
        shapes.addGeometryObject(pin.GeometryObject(name, joint, placement, shape))
        self._names.append(name)
        self._capsules.append((joint, start, end, capsule.radius))

    @property
    def pairs(self) -> list[tuple[str, str]]:
        """Names of the pairs that are kept apart."""
        return [(self._names[i], self._names[j]) for group in self._groups for i, j in group.pairs]

    def near(self, margin: float) -> Near:
        """The pairs closer than `margin` metres where `Kinematics.update` left the arms.

        The derivative of a distance is that of its two witness points along coal's normal, which,
        unlike the difference of the points, keeps its sign in penetration.
        """
        found = []
        for g in np.flatnonzero(self._bounds() < margin).tolist():
            group = self._groups[g]
            if self._nearest(g)[0] >= margin:
                continue
            results = group.data.distanceResults
            for k, result in enumerate(results):
                distance = result.min_distance
                if distance < margin:
                    witnesses = result.getNearestPoint1(), result.getNearestPoint2()
                    found.append((distance, result.normal, *witnesses, *group.bodies[k]))
        if not found:
            return Near(np.zeros(0), np.zeros((0, self._kinematics.model.nv)))
        distances, normals, first, second, one, other = zip(*found, strict=True)
        n = np.array(normals)
        J, moves = self._kinematics.J, self._kinematics.moves
        rows = (_wrench(n, np.array(second)) @ J) * moves[list(other)]
        rows -= (_wrench(n, np.array(first)) @ J) * moves[list(one)]
        return Near(np.array(distances), rows)

    def clearance(self) -> tuple[float, str]:
        """The least distance of all pairs, metres, and the pair's name."""
        bounds = self._bounds()
        best, nearest = np.inf, (0, 0)
        for g in np.argsort(bounds).tolist():
            if bounds[g] >= best:
                break
            distance, k = self._nearest(g)
            if distance < best:
                best, nearest = distance, self._groups[g].pairs[k]
        one, other = nearest
        return best, f"{self._names[one]} - {self._names[other]}"

    def _bounds(self) -> Float:
        """(G,) distances that no pair of a group can be closer than now."""
        turned = np.abs(self._least_at - self._kinematics.q)
        bounds: Float = self._least - turned @ self._lever
        return bounds

    def _nearest(self, g: int) -> tuple[float, int]:
        """Measure group `g`: its least distance and which pair has it."""
        group, kinematics = self._groups[g], self._kinematics
        pin.updateGeometryPlacements(kinematics.model, kinematics.data, group.geometry, group.data)
        k = int(pin.computeDistances(group.geometry, group.data))
        distance = float(group.data.distanceResults[k].min_distance)
        self._least[g], self._least_at[g] = distance, kinematics.q
        return distance, k

    def capsules(self) -> list[tuple[Float, Float, float]]:
        """(start, end, radius) of all capsules where `Kinematics` has the arms; world."""
        oMi = self._kinematics.data.oMi
        return [
            (oMi[joint].act(start), oMi[joint].act(end), radius)
            for joint, start, end, radius in self._capsules
        ]


def _pair_groups() -> list[list[tuple[int, int]]]:
    """Pairs of shapes: links of the left arm from 0, of the right arm from 9, boxes from 18."""
    n, boxes = len(LINKS), len(BODY) + 1
    fixed = len(FIXED_LINKS)
    # The two first links stand still beside each other.
    between = [
        [(i, n + j) for i in rows for j in range(n) if i + j > 0]
        for rows in ((0, 1, 2), (3, 4), (5, 6), (7, 8))
    ]
    around = [
        [(a + i, 2 * n + box) for a in (0, n) for i in range(fixed, n)] for box in range(boxes)
    ]
    within = [
        (a + LINKS.index(one), a + LINKS.index(other))
        for a in (0, n)
        for one, others in WITHIN_ARM.items()
        for other in others
    ]
    return [*between, *around, within]


def _levers() -> Float:
    """(14,) metres: no point of an arm is farther from the axis of its joint."""
    ends = [axis.link for axis in AXES] + [GRIPPER_BODY, FINGERS]
    widest = max(np.linalg.norm(end) + c.radius for c in ends for end in (c.start, c.end))
    steps = [abs(axis.a) + abs(axis.d) for axis in AXES]
    arm = [sum(steps[i + 1 :]) + FLANGE_M + float(widest) for i in range(len(AXES))]
    return np.array(arm + arm)


def _group(shapes: pin.GeometryModel, pairs: list[tuple[int, int]]) -> _Group:
    geometry = pin.GeometryModel(shapes)
    for pair in pairs:
        geometry.addCollisionPair(pin.CollisionPair(*pair))
    joints = np.array([shape.parentJoint for shape in shapes.geometryObjects])
    return _Group(pairs, joints[np.array(pairs)], geometry, geometry.createData())


def _wrench(normals: Float, points: Float) -> Float:
    """(K, 6) rows w with w @ (v, omega) = n . (v + omega x p)."""
    (nx, ny, nz), (px, py, pz) = normals.T, points.T
    return np.stack([nx, ny, nz, py * nz - pz * ny, pz * nx - px * nz, px * ny - py * nx], axis=1)
