"""Everything that may touch: capsules around the links, boxes around the body, the table.

Distances and normals are coal's. The capsules hull whole links with the air beside
them: in the controller's calibration posture, arms folded against the head, they touch it.
"""

from __future__ import annotations

from dataclasses import dataclass

import coal
import numpy as np
import pinocchio as pin

from clothrf_core.types import Float
from clothrf_yumi.compiled import recall
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
MEMORIES = 2
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


class Body:
    """Distances between the parts of the robot and to the table; shares `Kinematics`' work space.

    Body and table are padded, so that one threshold keeps the arms farther from them than from
    each other. Of each pair a bound is kept that its distance cannot be less than; turning the
    joints uses it up, and a pair is measured again only when its bound matters. Most pairs are far
    apart most of the time. There are two such memories, because whoever looks ahead asks about two
    postures in turn. The answers are the same as without memory.
    """

    def __init__(self, kinematics: Kinematics, *, table_height: float, padding: float) -> None:
        self._kinematics = kinematics
        self._names: list[str] = []
        self._capsules: list[tuple[int, Float, Float, float]] = []
        self._shapes = shapes = pin.GeometryModel()
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
        self._pairs = _pairs()
        for pair in self._pairs:
            shapes.addCollisionPair(pin.CollisionPair(*pair))
        self._data = shapes.createData()
        joints = [shape.parentJoint for shape in shapes.geometryObjects]
        one, other = np.array([(joints[i], joints[j]) for i, j in self._pairs]).T
        self._carrier = np.array([other, one])
        levers = self._reaches()
        first, second = levers[np.array(self._pairs).T]
        # A joint that carries both bodies of a pair, or none, does not change their distance.
        moving = np.abs(kinematics.moves[one] - kinematics.moves[other])
        self._levers = np.ascontiguousarray((moving * np.maximum(first, second)).T)
        self._bounds = np.full((MEMORIES, len(self._pairs)), -np.inf)
        self._postures = np.zeros((MEMORIES, kinematics.model.nv))
        self._bound = self._bounds[0]
        self._nothing = Near(np.zeros(0), np.zeros((0, kinematics.model.nv)))

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

    def _reaches(self) -> Float:
        """(23, 14) metres: no point of a shape is farther from the axis of a joint before it."""
        steps = np.array([np.hypot(axis.a, axis.d) for axis in AXES])
        levers = np.zeros((len(self._names), 2 * len(AXES)))
        for i, (joint, start, end, radius) in enumerate(self._capsules):
            arm, last = divmod(joint - 1, len(AXES))
            size = max(np.linalg.norm(start), np.linalg.norm(end)) + radius
            for k in range(last + 1):
                levers[i, arm * len(AXES) + k] = steps[k + 1 : last + 1].sum() + size
        return levers

    @property
    def pairs(self) -> list[tuple[str, str]]:
        """Names of the pairs that are kept apart."""
        return [(self._names[i], self._names[j]) for i, j in self._pairs]

    def near(self, margin: float) -> Near:
        """The pairs closer than `margin` metres where `Kinematics.update` left the arms.

        The derivative of a distance is that of its two witness points along coal's normal, which,
        unlike the difference of the points, keeps its sign in penetration.
        """
        self._place()
        distances, first, second, pairs = [], [], [], []
        for k in np.flatnonzero(self._bound < margin).tolist():
            result = self._measure(k)
            distance = result.min_distance
            if distance < margin:
                normal = result.normal.tolist()
                distances.append(distance)
                first.append(_wrench(normal, result.getNearestPoint1().tolist()))
                second.append(_wrench(normal, result.getNearestPoint2().tolist()))
                pairs.append(k)
        if not distances:
            return self._nothing
        n = len(pairs)
        speeds = np.array(second + first) @ self._kinematics.J
        speeds *= self._kinematics.moves[self._carrier[:, pairs].ravel()]
        return Near(np.array(distances), speeds[:n] - speeds[n:])

    def closer(self, margin: float) -> bool:
        """Any pair is closer than `margin` metres."""
        self._place()
        pairs = np.flatnonzero(self._bound < margin).tolist()
        return any(self._measure(k).min_distance < margin for k in pairs)

    def clearance(self) -> tuple[float, str]:
        """The least distance of all pairs, metres, and the pair's name."""
        self._place()
        measured: dict[int, float] = {}
        while (nearest := int(self._bound.argmin())) not in measured:
            measured[nearest] = float(self._measure(nearest).min_distance)
        one, other = self._pairs[nearest]
        return measured[nearest], f"{self._names[one]} - {self._names[other]}"

    def _place(self) -> None:
        """Follow the arms to where `Kinematics.update` left them."""
        model, data, q = self._kinematics.model, self._kinematics.data, self._kinematics.q
        pin.updateGeometryPlacements(model, data, self._shapes, self._data)
        self._bound = self._bounds[recall(self._bounds, self._postures, self._levers, q)]

    def _measure(self, k: int) -> coal.DistanceResult:
        result = pin.computeDistance(self._shapes, self._data, k)
        self._bound[k] = result.min_distance
        return result

    def capsules(self) -> list[tuple[Float, Float, float]]:
        """(start, end, radius) of all capsules where `Kinematics` has the arms; world."""
        oMi = self._kinematics.data.oMi
        return [
            (oMi[joint].act(start), oMi[joint].act(end), radius)
            for joint, start, end, radius in self._capsules
        ]


def _pairs() -> list[tuple[int, int]]:
    """Pairs of shapes: links of the left arm from 0, of the right arm from 9, boxes from 18."""
    n, boxes = len(LINKS), len(BODY) + 1
    # The two first links stand still beside each other.
    between = [(i, n + j) for i in range(n) for j in range(n) if i + j > 0]
    around = [
        (a + i, 2 * n + box)
        for a in (0, n)
        for i in range(len(FIXED_LINKS), n)
        for box in range(boxes)
    ]
    within = [
        (a + LINKS.index(one), a + LINKS.index(other))
        for a in (0, n)
        for one, others in WITHIN_ARM.items()
        for other in others
    ]
    return [*between, *around, *within]


def _wrench(n: list[float], p: list[float]) -> tuple[float, ...]:
    """Row w with w @ (v, omega) = n . (v + omega x p)."""
    (nx, ny, nz), (px, py, pz) = n, p
    return nx, ny, nz, py * nz - pz * ny, pz * nx - px * nz, px * ny - py * nx
