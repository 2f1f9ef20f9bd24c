"""The rectangular sheet that every simulator of the core's mesh contract holds by four corners."""

from __future__ import annotations

import math

import numpy as np

from clothrf_core.errors import ConfigError
from clothrf_core.params import SimulationParams
from clothrf_core.types import ClothMesh, Float

REACH = 1e-3
"""Relative excess of a corner distance over the sheet's own that still counts as reachable."""


def check_cloth(params: SimulationParams) -> None:
    """Refuse a cloth that cannot be.

    Raises:
        ConfigError: size, resolution or a number of the fabric is out of range.
    """
    fabric = params.fabric
    if min(params.resolution) < 2 or min(params.size) <= 0.0:
        raise ConfigError(
            "simulation: expected at least 2 x 2 vertices and a size above 0, got resolution "
            f"{params.resolution}, size {params.size} m"
        )
    positive = ("density", "stretch_warp", "stretch_weft")
    numbers = {k: getattr(fabric, k) for k in (*positive, "shear", "bending", "damping", "drag")}
    for key, value in numbers.items():
        if not np.isfinite(value) or value < 0.0 or (value == 0.0 and key in positive):
            raise ConfigError(
                f"fabric '{fabric.name}': expected {key} "
                f"{'> 0' if key in positive else '>= 0'}, got {value}"
            )


def grid_mesh(size: tuple[float, float], resolution: tuple[int, int]) -> ClothMesh:
    """Triangles, rest coordinates, corners and structural edges of a grid of vertices.

    Vertices run fastest along the side with fewer of them. Cells are cut along alternating
    diagonals, so that neither physics nor picture has a grain.

    Args:
        size: metres along u (between the hands) and along v (from hand to grasp).
        resolution: vertices along u and along v, each at least 2.
    """
    nu, nv = resolution
    number = np.arange(nu * nv, dtype=np.int32)
    index = number.reshape(nu, nv) if nu > nv else number.reshape(nv, nu).T  # [iu, iv]
    u, v = np.meshgrid(np.linspace(0, size[0], nu), np.linspace(0, size[1], nv), indexing="ij")
    rest = np.zeros((nu * nv, 2))
    rest[index.reshape(-1)] = np.stack([u.reshape(-1), v.reshape(-1)], axis=1)
    a, b = index[:-1, :-1], index[1:, :-1]
    c, d = index[:-1, 1:], index[1:, 1:]
    even = (np.add.outer(np.arange(nu - 1), np.arange(nv - 1)) % 2 == 0)[..., None]
    first = np.where(even, np.stack([a, b, d], -1), np.stack([a, b, c], -1))
    second = np.where(even, np.stack([a, d, c], -1), np.stack([b, d, c], -1))
    edges = [(index[:-1], index[1:]), (index[:, :-1], index[:, 1:])]
    return ClothMesh(
        triangles=np.concatenate([first.reshape(-1, 3), second.reshape(-1, 3)]).astype(np.int32),
        rest=rest,
        corners=np.array([index[0, 0], index[-1, 0], index[0, -1], index[-1, -1]], np.int32),
        edges=np.concatenate(
            [np.stack([p.reshape(-1), q.reshape(-1)], axis=1) for p, q in edges]
        ).astype(np.int32),
    )


def reachable(corners: Float, size: tuple[float, float]) -> bool:
    """Whether a flat sheet of `size` metres can have its corners there without stretching.

    A map of four points that lengthens no distance extends to the whole sheet without lengthening
    any (Kirszbraun 1934), and a short map is as near as one likes to an unstretched one (Nash
    1954), so the six corner distances decide.

    Args:
        corners: (4, 3) hand 0, hand 1, grasp 0, grasp 1.
        size: along u and v.
    """
    across, along = (n * (1.0 + REACH) for n in size)
    slant = math.hypot(across, along)
    hand0, hand1, grasp0, grasp1 = corners.tolist()
    return (
        math.dist(hand0, hand1) <= across
        and math.dist(grasp0, grasp1) <= across
        and math.dist(hand0, grasp0) <= along
        and math.dist(hand1, grasp1) <= along
        and math.dist(hand0, grasp1) <= slant
        and math.dist(hand1, grasp0) <= slant
    )


def hung(rest: Float, corners: Float) -> Float:
    """(V, 3) vertices of a sheet whose corners are given, both directions at their rest lengths.

    A bilinear patch between the corners; where two opposite sides are nearer than the sheet is
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
