"""The frame that two hands span: across, from the hands to the robot, and upwards.

``d = h1 - h0``, ``c = z x d / |z x d|``, ``n = d x c / |d x c|`` with z the world's up. Hands are
numbered so that c points from the hands to the robot: with the robot at x = 0 and the person in
front of it, hand 0 has the smaller y.
"""

from __future__ import annotations

import math
from dataclasses import dataclass

import numpy as np

from clothrf_core.types import ClothState, Float

# A vector shorter than this (m) has no direction; and one too short to choose a side by.
_ZERO = 1e-12
_SHORT = 1e-6


@dataclass(frozen=True, slots=True, eq=False)
class Directions:
    """Directions of the cloth that two hands hold.

    Attributes:
        middle: (3,) float64 midpoint of the hands, world, m.
        distance: |d|, m.
        c: (3,) float64 unit vector from the hands to the robot, perpendicular to d.
        n: (3,) float64 unit vector perpendicular to d and c; up when the hands are level.
    """

    middle: Float
    distance: float
    c: Float
    n: Float


def directions(state: ClothState, *, eps: float) -> Directions:
    """The frame of the hands of `state`; defined for every pose of the hands.

    Where the hands stand above each other, z x d has no direction. Within `eps` metres of that the
    result turns smoothly into the horizontal direction from the hands to the grippers. The grippers
    stand where the last c put them, so this holds the previous c, yet it remains a function of the
    state alone: no memory, the same state always has the same label.

    Args:
        state: the hands, and the grasp for the fall-back.
        eps: length of d on the ground plan, m, from which c is exactly z x d / |z x d|.
    """
    h0, h1 = state.hands
    dx, dy, dz = (float(v) for v in h1 - h0)
    middle = 0.5 * (h0 + h1)
    distance = math.sqrt(dx * dx + dy * dy + dz * dz)
    ground = math.hypot(dx, dy)
    d = np.array([dx, dy, dz])
    if ground >= eps:
        c = np.array([-dy / ground, dx / ground, 0.0])
    else:
        c = _near_vertical(d, distance, ground / eps, state.grasp.mean(axis=0) - middle)
    if distance > _ZERO:
        n = _cross(d, c) / distance
    else:
        n = _unit(_perpendicular(np.array([0.0, 0.0, 1.0]), c))
    return Directions(middle=middle, distance=distance, c=c, n=n)


def _near_vertical(d: Float, distance: float, weight: float, to_grasp: Float) -> Float:
    """Blend of z x d (at `weight` 1) and the ground-plan direction to the grasp (at 0)."""
    axis = d / distance if distance > _ZERO else np.zeros(3)
    # Grasp straight above the hands: towards the robot's base; along d: sideways.
    candidates = ([to_grasp[0], to_grasp[1], 0.0], [-1.0, 0.0, 0.0], [0.0, 1.0, 0.0])
    held = np.zeros(3)
    for candidate in candidates:
        held = _perpendicular(np.array(candidate), axis)
        if np.linalg.norm(held) > _SHORT:
            break
    held = _unit(held)
    if weight <= 0.0:
        return held
    ground = math.hypot(d[0], d[1])
    exact = np.array([-d[1] / ground, d[0] / ground, 0.0])
    blend: Float = weight * exact + (1.0 - weight) * held
    return _unit(blend) if np.linalg.norm(blend) > 1e-3 else held


def _perpendicular(vector: Float, axis: Float) -> Float:
    result: Float = vector - float(vector @ axis) * axis
    return result


def _unit(vector: Float) -> Float:
    result: Float = vector / np.linalg.norm(vector)
    return result


def _cross(a: Float, b: Float) -> Float:
    return np.array(
        [a[1] * b[2] - a[2] * b[1], a[2] * b[0] - a[0] * b[2], a[0] * b[1] - a[1] * b[0]]
    )
