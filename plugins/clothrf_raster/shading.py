"""Lambert's law on both sides of every surface, smooth where the surface is smooth.

A corner takes the normal of its vertex (faces weighted by area), unless one of the faces around the
vertex leans more than 50 degrees from it: then each face keeps its own. So cloth and spheres look
round and boxes keep their edges. Sums are written out, so that `compiled.py` gives the same bits.
"""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from clothrf_core.scene import SceneMesh
from clothrf_core.types import Float, Float32

CREASE_COSINE = 0.64
LEVELS = 1024
GAMMA = 2.2
TINY = 1e-300


def corner_shades(mesh: SceneMesh, eye: Float, light: Float) -> Float32:
    """(M, 3) float32 cosine between each corner's normal, turned to the eye, and the light.

    Args:
        mesh: M triangles.
        eye: (3,) position of the camera, world.
        light: (3,) unit vector in which the light travels.
    """
    t = mesh.triangles
    v = mesh.vertices
    a, b, c = (v[t[:, k]] for k in range(3))
    faces = _cross(b - a, c - a)
    away = _dot(faces, a - eye) > 0.0
    normals = np.empty_like(v)
    for axis in range(3):
        weights = np.repeat(faces[:, axis], 3)
        normals[:, axis] = np.bincount(t.ravel(), weights=weights, minlength=len(v))
    faces = _unit(faces)
    normals = _unit(normals)
    flat = _dot(faces, light)
    creased = np.zeros(len(v), bool)
    for k in range(3):
        creased[t[_dot(normals[t[:, k]], faces) < CREASE_COSINE, k]] = True
    shades = np.empty(t.shape, np.float32)
    for k in range(3):
        toward = np.where(creased[t[:, k]], flat, _dot(normals[t[:, k]], light))
        shades[:, k] = np.where(away, toward, -toward)
    return shades


def palette(
    colour: tuple[float, float, float], ambient: float, intensity: float
) -> NDArray[np.uint8]:
    """(LEVELS, 3) uint8 display colours of a linear RGB surface for cosines from 0 to 1."""
    strength = ambient + intensity * np.linspace(0.0, 1.0, LEVELS)
    return encode(strength[:, None] * np.asarray(colour, float))


def encode(linear: Float) -> NDArray[np.uint8]:
    """Linear [0, 1] as 8-bit display values (gamma 2.2, as SAPIEN's shaders write them)."""
    return np.rint(255.0 * np.clip(linear, 0.0, 1.0) ** (1.0 / GAMMA)).astype(np.uint8)


def _cross(a: Float, b: Float) -> Float:
    x = a[:, 1] * b[:, 2] - a[:, 2] * b[:, 1]
    y = a[:, 2] * b[:, 0] - a[:, 0] * b[:, 2]
    z = a[:, 0] * b[:, 1] - a[:, 1] * b[:, 0]
    return np.stack([x, y, z], axis=1)


def _dot(a: Float, b: Float) -> Float:
    result: Float = a[..., 0] * b[..., 0] + a[..., 1] * b[..., 1] + a[..., 2] * b[..., 2]
    return result


def _unit(vectors: Float) -> Float:
    result: Float = vectors / (np.sqrt(_dot(vectors, vectors)) + TINY)[:, None]
    return result
