"""Where the arms wait: at the rig's rest corners, tools forward and down, far from every limit."""

from __future__ import annotations

import math
from dataclasses import dataclass

import numpy as np

from clothrf_core.errors import ConfigError, RefusedTarget
from clothrf_core.types import Float
from clothrf_yumi.ik import InverseKinematics
from clothrf_yumi.kinematics import Kinematics

# Left arm, degrees, along its chain. Best of 150 random starts in the least of three margins: to
# the joint limits, to a collision (9 cm) and to a singularity, with the default stance.
SEED_DEG = (-19.71, -48.62, -8.01, 25.44, 60.44, 85.32, -42.60)
MIRROR = (-1.0, 1.0, -1.0, 1.0, -1.0, 1.0, -1.0)
REST_GRASP = ((0.492, -0.15, 0.475), (0.489, 0.15, 0.479))
STEP_M = 0.05
LEAST, MOST = -1.6, 2.4  # rad, of a tool's pitch


def seed() -> Float:
    """(14,) posture with both grippers near (0.49, -+0.15, 0.477), tools 57 degrees down."""
    left = np.radians(SEED_DEG)
    return np.concatenate([left, left * MIRROR])


@dataclass(frozen=True, slots=True)
class Stance:
    """How the tools should point: forward and down, the fingers' hinges along y.

    Close to the body they tip over towards it, or the wrists would have to be inside the body; far
    away they reach forward, or the forearms would be too short.

    Attributes:
        pitch: how far down at `x`, rad; pi / 2 = straight down, more = tips towards the body.
        lean: rad more for each metre nearer to the body.
        x: where the tools have that pitch, m.
    """

    pitch: float
    lean: float
    x: float

    def rotations(self, points: Float) -> Float:
        """(2, 3, 3) tools of grippers at (2, 3) `points`, world."""
        R = np.zeros((2, 3, 3))
        for tool, x in zip(R, points[:, 0].tolist(), strict=True):
            pitch = min(max(self.pitch + self.lean * (self.x - x), LEAST), MOST)
            c, s = math.cos(pitch), math.sin(pitch)
            tool[0, 0] = tool[2, 2] = -s
            tool[0, 2], tool[1, 1], tool[2, 0] = c, 1.0, -c
        return R


def posture_at(
    corners: Float, kinematics: Kinematics, solver: InverseKinematics, *, start: Float
) -> Float:
    """(14,) posture whose grippers are at (2, 3) `corners`, reached from `start` in small steps.

    Raises:
        ConfigError: the corners cannot be reached.
    """
    q = start
    begin = kinematics.grasp_points(q)
    steps = int(np.ceil(np.linalg.norm(corners - begin, axis=1).max() / STEP_M)) + 1
    try:
        for share in np.linspace(0.0, 1.0, steps + 1)[1:]:
            q = solver.solve(q, begin + share * (corners - begin), 1.0)
        for _ in range(40):  # the postures settle
            q = solver.solve(q, corners, 1.0)
    except RefusedTarget as error:
        raise ConfigError(
            "rig.grasp.rest: expected corners that both arms reach, got "
            f"{corners.tolist()}: {error}"
        ) from error
    return q
