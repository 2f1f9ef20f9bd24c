"""Surface normals for shading: smooth where a surface is smooth, sharp at its edges.

A corner takes the normal of its vertex (faces weighted by area), unless one of the faces around the
vertex leans more than 50 degrees from it: then each face keeps its own. So cloth and spheres look
round and boxes keep their edges. Sums are written out, so that compiled renderers can give the
same bits.
"""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from clothrf_core.types import Float

CREASE_COSINE = 0.64
TINY = 1e-300


def face_vectors(vertices: Float, triangles: NDArray[np.int32]) -> Float:
    """(M, 3) cross products of two edges: normal to each triangle, twice its area long."""
    a, b, c = (vertices[triangles[:, k]] for k in range(3))
    return _cross(b - a, c - a)


def corner_normals(vertices: Float, triangles: NDArray[np.int32]) -> Float:
    """(M, 3, 3) unit normal at each corner of (M, 3) triangles with (V, 3) vertices.

    Normals point to the side from which the corners run counter-clockwise; those of triangles
    without area are zero.
    """
    faces = face_vectors(vertices, triangles)
    normals = np.empty_like(vertices)
    for axis in range(3):
        weights = np.repeat(faces[:, axis], 3)
        normals[:, axis] = np.bincount(triangles.ravel(), weights=weights, minlength=len(vertices))
    faces = _unit(faces)
    normals = _unit(normals)
    creased = np.zeros(len(vertices), bool)
    for k in range(3):
        creased[triangles[dot(normals[triangles[:, k]], faces) < CREASE_COSINE, k]] = True
    result: Float = np.where(creased[triangles][:, :, None], faces[:, None], normals[triangles])
    return result


def dot(a: Float, b: Float) -> Float:
    """Scalar products along the last axis of length 3, summed from left to right."""
    result: Float = a[..., 0] * b[..., 0] + a[..., 1] * b[..., 1] + a[..., 2] * b[..., 2]
    return result


def _cross(a: Float, b: Float) -> Float:
    x = a[:, 1] * b[:, 2] - a[:, 2] * b[:, 1]
    y = a[:, 2] * b[:, 0] - a[:, 0] * b[:, 2]
    z = a[:, 0] * b[:, 1] - a[:, 1] * b[:, 0]
    return np.stack([x, y, z], axis=1)


def _unit(vectors: Float) -> Float:
    result: Float = vectors / (np.sqrt(dot(vectors, vectors)) + TINY)[:, None]
    return result
