"""Where the arms wait: at the rig's rest corners, tools forward and down, far from every limit."""

from __future__ import annotations

import numpy as np

from clothrf_core.errors import ConfigError, RefusedTarget
from clothrf_core.types import Float
from clothrf_yumi.ik import InverseKinematics
from clothrf_yumi.kinematics import Kinematics

# Left arm, degrees, along its chain. Best of 150 random starts in the least of three margins: to
# the joint limits (18 % of their range), to a collision (8 cm) and to a singularity.
SEED_DEG = (-19.37, -58.03, -7.10, 42.97, 79.68, 65.20, -54.87)
MIRROR = (-1.0, 1.0, -1.0, 1.0, -1.0, 1.0, -1.0)
REST_GRASP = ((0.492, -0.15, 0.475), (0.489, 0.15, 0.479))
STEP_M = 0.05


def seed() -> Float:
    """(14,) posture with both grippers near (0.49, -+0.15, 0.477), tools 57 degrees down."""
    left = np.radians(SEED_DEG)
    return np.concatenate([left, left * MIRROR])


def tool_rotations(pitch: float) -> Float:
    """(2, 3, 3) tools that point forward and `pitch` radians down, the fingers' hinges along y."""
    c, s = np.cos(pitch), np.sin(pitch)
    R = np.array([[-s, 0.0, c], [0.0, 1.0, 0.0], [-c, 0.0, -s]])
    return np.stack([R, R])


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
        for _ in range(20):  # the postures settle
            q = solver.solve(q, corners, 1.0)
    except RefusedTarget as error:
        raise ConfigError(
            "rig.grasp.rest: expected corners that both arms reach, got "
            f"{corners.tolist()}: {error}"
        ) from error
    return q
