"""Lambert's law on both sides of every surface, with the normals of `clothrf_core.normals`."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from clothrf_core.normals import corner_normals, dot, face_vectors
from clothrf_core.scene import SceneMesh
from clothrf_core.types import Float, Float32

LEVELS = 1024
GAMMA = 2.2


def corner_shades(mesh: SceneMesh, eye: Float, light: Float) -> Float32:
    """(M, 3) float32 cosine between each corner's normal, turned to the eye, and the light.

    Args:
        mesh: M triangles.
        eye: (3,) position of the camera, world.
        light: (3,) unit vector in which the light travels.
    """
    first = mesh.vertices[mesh.triangles[:, 0]]
    away = dot(face_vectors(mesh.vertices, mesh.triangles), first - eye) > 0.0
    toward = dot(corner_normals(mesh.vertices, mesh.triangles), light)
    shades: Float32 = np.where(away[:, None], toward, -toward).astype(np.float32)
    return shades


def palette(
    colour: tuple[float, float, float], ambient: float, intensity: float
) -> NDArray[np.uint8]:
    """(LEVELS, 3) uint8 display colours of a linear RGB surface for cosines from 0 to 1."""
    strength = ambient + intensity * np.linspace(0.0, 1.0, LEVELS)
    return encode(strength[:, None] * np.asarray(colour, float))


def encode(linear: Float) -> NDArray[np.uint8]:
    """Linear [0, 1] as 8-bit display values (gamma 2.2)."""
    return np.rint(255.0 * np.clip(linear, 0.0, 1.0) ** (1.0 / GAMMA)).astype(np.uint8)
