"""The YuMi as an `ArmModel`: what the command stream and the bridge ask about it."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np
from typing_extensions import override

from clothrf_core.errors import RefusedTarget
from clothrf_core.interfaces import ArmModel, JointLimiter
from clothrf_core.provider import BuildContext
from clothrf_core.types import Float
from clothrf_yumi.body import Body
from clothrf_yumi.config import YumiConfig
from clothrf_yumi.ik import InverseKinematics, Patience, Weights
from clothrf_yumi.irb14000 import BODY, JOINT_NAMES
from clothrf_yumi.kinematics import Kinematics
from clothrf_yumi.limiter import RuckigLimiter
from clothrf_yumi.limits import Limits
from clothrf_yumi.posture import REST_GRASP, Stance, posture_at, seed

TABLE_HEIGHT_M = -0.02


class Yumi(ArmModel):
    """Both arms of an IRB 14000. Holds work space: one object a thread.

    Joint vectors: left arm, then right arm, each along its chain (axes 1, 2, 7, 3, 4, 5, 6).
    Grasp point 0 (at y < 0) is the right gripper, 1 the left one.

    Args:
        config: see `YumiConfig`.
        corners: (2, 3) where the grippers wait, world.
        table_height: top of the table, world z, metres.

    Raises:
        ConfigError: the arms do not reach the corners.
    """

    def __init__(self, config: YumiConfig, *, corners: Float, table_height: float) -> None:
        self._limits = Limits.of(config.profile)
        self._kinematics = Kinematics(config.tool)
        self._body = Body(self._kinematics, table_height=table_height, padding=config.padding)
        self._low, self._high = np.array(config.box_low), np.array(config.box_high)
        weights = Weights(orientation=config.orientation, posture=config.posture)
        patience = Patience(jump=config.jump, reach=config.reach, clearance=config.clearance)
        stance = Stance(config.pitch, config.lean, float(corners[:, 0].mean()))
        start = seed()

        def solver(limits: Limits, ready: Float) -> InverseKinematics:
            return InverseKinematics(
                self._kinematics,
                self._body,
                limits=limits,
                ready=ready,
                rotations=stance.rotations,
                weights=weights,
                patience=patience,
            )

        # The way to the ready posture is not driven, so the profile's speeds do not matter to it.
        self._ready = posture_at(
            corners, self._kinematics, solver(Limits.of("normal"), start), start=start
        )
        self._ready.setflags(write=False)
        self._solver = solver(self._limits, self._ready)

    @property
    @override
    def joint_names(self) -> tuple[str, ...]:
        return JOINT_NAMES

    @property
    @override
    def limits(self) -> Limits:
        return self._limits

    @property
    @override
    def ready(self) -> Float:
        return self._ready.copy()

    @override
    def grasp_points(self, q: Float) -> Float:
        return self._kinematics.grasp_points(np.asarray(q, dtype=np.float64))

    @override
    def solve(self, q: Float, targets: Float, dt: float) -> Float:
        targets = np.asarray(targets, dtype=np.float64)
        inside = (targets >= self._low) & (targets <= self._high)
        if not inside.all():
            i = int(np.argwhere(~inside)[0, 0])
            raise RefusedTarget(
                f"targets[{i}]: expected a point between {self._low.tolist()} and "
                f"{self._high.tolist()}, got {np.round(targets[i], 3).tolist()}; widen arm.box_low "
                "and arm.box_high if the space is free"
            )
        return self._solver.solve(q, targets, dt)

    @override
    def clearance(self, q: Float) -> tuple[float, str]:
        self._kinematics.update(np.asarray(q, dtype=np.float64))
        return self._body.clearance()

    @override
    def grasp_speeds(self, q: Float, qd: Float) -> Float:
        self._kinematics.update(np.asarray(q, dtype=np.float64))
        speeds = (self._kinematics.grasp_jacobian()[:6] @ qd).reshape(2, 3)
        norms: Float = np.sqrt(np.einsum("ij,ij->i", speeds, speeds))
        return norms

    @override
    def limiter(self, dt: float, *, q: Float) -> JointLimiter:
        return RuckigLimiter(self._limits, dt, q=q)

    @override
    def capsules(self, q: Float) -> Sequence[tuple[Float, Float, float]]:
        self._kinematics.update(np.asarray(q, dtype=np.float64))
        return self._body.capsules()

    @override
    def fixtures(self) -> Sequence[tuple[Float, Float]]:
        return [(np.array(box.low), np.array(box.high)) for box in BODY]


def build(config: YumiConfig, context: BuildContext) -> Yumi:
    """The model for the rig of `context`, or for the paper's rig where there is none."""
    rig = context.rig
    corners = np.array(REST_GRASP) if rig is None else rig.rest_grasp
    height = config.table_height
    if height is None:
        height = TABLE_HEIGHT_M if rig is None else rig.table.high[2]
    return Yumi(config, corners=corners, table_height=height)
