"""The shape a cloth starts from: hung between four corners, its slack sagging."""

from __future__ import annotations

import numpy as np

from clothrf_core.types import Float


def hung(rest: Float, corners: Float) -> Float:
    """(V, 3) vertices of a cloth whose corners are given, both directions at their rest lengths.

    A bilinear patch between the corners; where two opposite sides are nearer than the cloth is
    long, every thread between them is a circular arc of its own length, hanging down.

    Args:
        rest: (V, 2) flat coordinates u, v, metres.
        corners: (4, 3) hand 0, hand 1, grasp 0, grasp 1, world.
    """
    size = rest.max(axis=0)
    u, v = rest[:, 0] / size[0], rest[:, 1] / size[1]
    hand0, hand1, grasp0, grasp1 = corners
    across = 0.5 * ((hand1 - hand0) + (grasp1 - grasp0))
    along = 0.5 * ((grasp0 - hand0) + (grasp1 - hand1))
    down = _sag_direction(across, along)
    u_part, u_sag = _arc(u, float(np.linalg.norm(across)), float(size[0]))
    v_part, v_sag = _arc(v, float(np.linalg.norm(along)), float(size[1]))
    a, b = u_part[:, None], v_part[:, None]
    flat = (1 - b) * ((1 - a) * hand0 + a * hand1) + b * ((1 - a) * grasp0 + a * grasp1)
    # Where one direction is at its ends the other alone sags, so the corners stay put.
    shape: Float = flat + (u_sag + v_sag)[:, None] * down
    return shape


def _sag_direction(across: Float, along: Float) -> Float:
    """Unit vector: down, without its part along the longer chord if that leaves anything."""
    down = np.array([0.0, 0.0, -1.0])
    v_longer = bool(np.linalg.norm(along) >= np.linalg.norm(across))
    chord, other = (along, across) if v_longer else (across, along)
    for candidate in (down, np.cross(across, along), other, np.array([1.0, 0.0, 0.0])):
        direction = np.array(candidate)
        length = float(np.linalg.norm(chord))
        if length > 1e-9:
            direction = direction - (direction @ chord) * chord / length**2
        if np.linalg.norm(direction) > 0.1 * max(float(np.linalg.norm(candidate)), 1e-6):
            unit: Float = direction / np.linalg.norm(direction)
            return unit
    return np.array([0.0, 1.0, 0.0])


def _arc(s: Float, chord: float, length: float) -> tuple[Float, Float]:
    """Along and across the chord (as shares of it; metres) at arc-length shares s of an arc."""
    if chord >= length:
        return s, np.zeros_like(s)
    low, high = 0.0, float(np.pi)
    half = 0.5 * high
    for _ in range(60):  # sin(t) / t falls from 1 to 0 on (0, pi)
        half = 0.5 * (low + high)
        if np.sin(half) / half > chord / length:
            low = half
        else:
            high = half
    radius = length / (2.0 * half)
    angle = half * (2.0 * s - 1.0)
    part = 0.5 + radius * np.sin(angle) / max(chord, 1e-9)
    sag = radius * (np.cos(angle) - np.cos(half))
    if chord < 1e-9:
        part = np.full_like(s, 0.5)
    part = np.where(s == 0.0, 0.0, np.where(s == 1.0, 1.0, part))
    return part, np.where((s == 0.0) | (s == 1.0), 0.0, sag)
