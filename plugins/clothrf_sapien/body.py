"""Meshes as SAPIEN entities; what has not changed since the last frame is kept."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any

import numpy as np

from clothrf_core.normals import corner_normals, dot, face_vectors
from clothrf_core.scene import SceneMesh
from clothrf_core.types import Float, Float32

NO_DEPTH = 128
NO_UV = np.zeros((0, 2), np.float32)


@dataclass(frozen=True, slots=True, eq=False)
class Body:
    """A mesh in the scene.

    Attributes:
        entity: SAPIEN's.
        mesh: copy of what it shows; the owner of the original may write into its arrays.
        eye: (3,) where it is looked at from, world.
    """

    entity: Any
    mesh: SceneMesh
    eye: Float

    def shows(self, mesh: SceneMesh, eye: Float) -> bool:
        """Whether `mesh` looks the same from `eye`."""
        mine = self.mesh
        return (
            (mine.label, mine.measurable, tuple(mine.colour))
            == (mesh.label, mesh.measurable, tuple(mesh.colour))
            and np.array_equal(self.eye, eye)
            and np.array_equal(mine.vertices, mesh.vertices)
            and np.array_equal(mine.triangles, mesh.triangles)
        )


def make_body(mesh: SceneMesh, eye: Float, *, shadows: bool) -> Body:
    """An entity, not yet in a scene, that shows `mesh` to an eye at (3,) `eye`.

    With `shadows` every triangle is there twice: the side that the eye sees is not always the one
    that the light sees, and SAPIEN skips the backs for both.
    """
    import sapien
    from sapien import render

    material = render.RenderMaterial()
    material.base_color = [*mesh.colour, 1.0]
    # Read by our shaders: what is seen, and whether a depth camera reads anything on it.
    material.emission = [0.0, 0.0, 0.0, float(code_of(mesh))]
    vertices, normals = turned_to(mesh, eye)
    if shadows:
        vertices = np.concatenate([vertices, vertices[::-1]])
        normals = np.concatenate([normals, -normals[::-1]])
    triangles = np.arange(len(vertices), dtype=np.uint32).reshape(-1, 3)
    shape = render.RenderShapeTriangleMesh(vertices, triangles, normals, NO_UV, material)
    component = render.RenderBodyComponent()
    component.attach(shape)
    entity = sapien.Entity()
    entity.add_component(component)
    kept = SceneMesh(
        label=mesh.label,
        vertices=np.array(mesh.vertices),
        triangles=np.array(mesh.triangles),
        colour=mesh.colour,
        measurable=mesh.measurable,
    )
    return Body(entity, kept, np.array(eye))


def turned_to(mesh: SceneMesh, eye: Float) -> tuple[Float32, Float32]:
    """(3M, 3) float32 corners and normals of the triangles one after the other.

    SAPIEN draws front sides only; every triangle is wound so that `eye` sees its front.
    """
    corners = mesh.vertices[mesh.triangles]
    normals = corner_normals(mesh.vertices, mesh.triangles)
    facing = dot(face_vectors(mesh.vertices, mesh.triangles), corners[:, 0] - eye)
    away = (facing > 0.0)[:, None, None]
    vertices = np.where(away, corners[:, ::-1], corners).reshape(-1, 3)
    directions = np.where(away, -normals[:, ::-1], normals).reshape(-1, 3)
    return vertices.astype(np.float32), directions.astype(np.float32)


def code_of(mesh: SceneMesh) -> int:
    """One byte: the label, plus 128 for surfaces that give no depth."""
    return int(mesh.label) + (0 if mesh.measurable else NO_DEPTH)
