"""Where the grippers are and how they move: Pinocchio on the project's own URDF."""

from __future__ import annotations

from importlib.resources import files

import numpy as np
import pinocchio as pin

from clothrf_core.errors import ShapeError
from clothrf_core.types import Float
from clothrf_yumi.irb14000 import JOINT_NAMES

# Grasp point 0 is at y < 0, on the right arm's side; the joint vector starts with the left arm.
GRASP_TOOLS = ("yumi_tool0_r", "yumi_tool0_l")


class Kinematics:
    """Forward kinematics and Jacobians of both arms; holds work space, so one a thread.

    Joint vectors are (14,) float64 radians: left arm, then right arm, each along its chain.

    Attributes:
        model: Pinocchio's model.
        data: its work space, as the last `update` left it.
        q: (14,) posture of the last `update`.
        J: (6, 14) Jacobian of all joints at the world's origin (linear, then angular velocity).
        points: (2, 3) gripper positions of the last `update`, world.
    """

    def __init__(self, tool_m: float) -> None:
        text = files("clothrf_yumi").joinpath("yumi.urdf").read_text(encoding="utf-8")
        self.model = pin.buildModelFromXML(text)
        if tuple(self.model.names)[1:] != JOINT_NAMES:
            raise ShapeError(
                f"yumi.urdf: expected joints {JOINT_NAMES}, found {tuple(self.model.names)[1:]}; "
                "write it anew with python -m clothrf_yumi.urdf"
            )
        self._frames = [self._add_grasp_frame(name, tool_m) for name in GRASP_TOOLS]
        self.data = self.model.createData()
        # (15, 14) mask: which joints move body i.
        self.moves = np.zeros((self.model.njoints, self.model.nv))
        for body in range(1, self.model.njoints):
            columns = [self.model.idx_vs[j] for j in self.model.supports[body] if j > 0]
            self.moves[body, columns] = 1.0
        self._key = b""
        self.q = np.zeros(self.model.nq)
        self.J = np.zeros((6, self.model.nv))
        self.points = np.zeros((2, 3))

    def _add_grasp_frame(self, tool: str, tool_m: float) -> int:
        flange = self.model.frames[self.model.getFrameId(tool)]
        tip = flange.placement * pin.SE3(np.eye(3), np.array([0.0, 0.0, tool_m]))
        name = tool.replace("tool0", "grasp")
        frame = pin.Frame(name, flange.parentJoint, tip, pin.FrameType.OP_FRAME)
        return int(self.model.addFrame(frame))

    def update(self, q: Float) -> None:
        """Bring positions and the Jacobian to (14,) `q`; nothing is done if they are there."""
        key = q.tobytes()
        if key == self._key:
            return
        self._key = key
        self.q = q.copy()
        self.J = pin.computeJointJacobians(self.model, self.data, q)
        self._place()

    def grasp_points(self, q: Float) -> Float:
        """(2, 3) gripper positions at `q`, world."""
        self.update(q)
        return self.points.copy()

    def _place(self) -> None:
        for i, frame in enumerate(self._frames):
            self.points[i] = pin.updateFramePlacement(self.model, self.data, frame).translation

    def rotations(self) -> tuple[Float, Float]:
        """Two (3, 3) rotations of the tools at the last `update`, world."""
        one, other = self._frames
        return self.data.oMf[one].rotation, self.data.oMf[other].rotation

    def grasp_jacobian(self) -> Float:
        """(12, 14) at the last `update`: linear velocities of points 0 and 1, then angular ones."""
        rows = np.empty((12, self.model.nv))
        for i, frame in enumerate(self._frames):
            J = pin.getFrameJacobian(self.model, self.data, frame, pin.LOCAL_WORLD_ALIGNED)
            rows[3 * i : 3 * i + 3] = J[:3]
            rows[6 + 3 * i : 9 + 3 * i] = J[3:]
        return rows
