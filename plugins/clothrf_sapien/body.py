"""Meshes as SAPIEN entities; what has not changed since the last frame is kept."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any

import numpy as np

from clothrf_core.normals import corner_normals, dot, face_vectors
from clothrf_core.scene import Pattern, SceneMesh
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
        return np.array_equal(self.eye, eye) and self.mesh.looks_like(mesh)


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
    uv = NO_UV
    vertices, normals, places = turned_to(mesh, eye)
    if mesh.pattern is not None:
        material.base_color_texture = picture_of(mesh.pattern)
        uv = places
    if shadows:
        vertices = np.concatenate([vertices, vertices[::-1]])
        normals = np.concatenate([normals, -normals[::-1]])
        uv = np.concatenate([uv, uv[::-1]])
    triangles = np.arange(len(vertices), dtype=np.uint32).reshape(-1, 3)
    shape = render.RenderShapeTriangleMesh(vertices, triangles, normals, uv, material)
    component = render.RenderBodyComponent()
    component.attach(shape)
    entity = sapien.Entity()
    entity.add_component(component)
    return Body(entity, mesh.copy(), np.array(eye))


def picture_of(pattern: Pattern) -> Any:
    """A pattern as SAPIEN's texture; the nearest texel counts, as everywhere."""
    from sapien import render

    colours = np.concatenate([pattern.colours, np.ones((len(pattern.colours), 1))], axis=1)
    texels = np.ascontiguousarray(colours[pattern.texels], np.float32)
    return render.RenderTexture2D(
        texels, "R32G32B32A32Sfloat", 1, filter_mode="nearest", address_mode="edge"
    )


def turned_to(mesh: SceneMesh, eye: Float) -> tuple[Float32, Float32, Float32]:
    """(3M, 3) float32 corners and normals of the triangles one after the other; (3M, 2) places.

    SAPIEN draws front sides only; every triangle is wound so that `eye` sees its front.
    """
    corners = mesh.vertices[mesh.triangles]
    normals = corner_normals(mesh.vertices, mesh.triangles)
    facing = dot(face_vectors(mesh.vertices, mesh.triangles), corners[:, 0] - eye)
    away = (facing > 0.0)[:, None, None]
    vertices = np.where(away, corners[:, ::-1], corners).reshape(-1, 3)
    directions = np.where(away, -normals[:, ::-1], normals).reshape(-1, 3)
    if mesh.pattern is None:
        return vertices.astype(np.float32), directions.astype(np.float32), NO_UV
    places = mesh.uv[mesh.triangles]
    places = np.where(away, places[:, ::-1], places).reshape(-1, 2)
    f = np.float32
    return vertices.astype(f), directions.astype(f), places.astype(f)


def code_of(mesh: SceneMesh) -> int:
    """One byte: the label, plus 128 for surfaces that give no depth."""
    return int(mesh.label) + (0 if mesh.measurable else NO_DEPTH)
