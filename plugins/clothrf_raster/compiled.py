"""The fast engine, compiled by numba; `plain.py` is the same in numpy, bit for bit."""

from __future__ import annotations

import math

import numpy as np
from numba import njit
from numpy.typing import NDArray

from clothrf_core.normals import CREASE_COSINE, TINY
from clothrf_core.scene import SceneMesh
from clothrf_core.types import Float, Float32
from clothrf_raster.canvas import ROUND, Canvas, Ink, Keys
from clothrf_raster.compiled_bend import draw_bent
from clothrf_raster.compiled_fill import ONE, clip, colour, fill
from clothrf_raster.view import View


def draw(canvas: Canvas, view: View, mesh: SceneMesh, ink: Ink) -> None:
    """Draw `mesh` on `canvas` wherever it is closer than what is there."""
    vertices = np.ascontiguousarray(mesh.vertices)
    triangles = np.ascontiguousarray(mesh.triangles)
    keys = canvas.keys.reshape(-1)
    paint = canvas.paint.reshape(-1)
    levels = len(ink.palette) - 1
    stride = canvas.keys.shape[1]
    bend = view.bend
    if bend.piece > 0.0:
        draw_bent(
            vertices, triangles, view.pose, view.lens, view.near,
            bend.coefficients, bend.piece, bend.window,
            keys, stride, canvas.width, paint, canvas.rows, ink.code, ink.shades, levels,
        )  # fmt: skip
    else:
        _draw(
            vertices, triangles, view.pose, view.lens, view.near,
            keys, stride, canvas.width, paint, canvas.rows, ink.code, ink.shades, levels,
        )  # fmt: skip
    if paint.size > 0:
        colour(paint, stride, canvas.rows, ink.palette, canvas.rgb, canvas.words)


def finish(canvas: Canvas, view: View, depth: Float32, labels: NDArray[np.uint8]) -> None:
    """Write metres, or NaN where nothing measurable is seen, and labels; both (H, W)."""
    _finish(canvas.keys, canvas.empty, np.float32(view.near), np.float32(view.far), depth, labels)


@njit(cache=True, nogil=True, error_model="numpy")
def _finish(
    keys: Keys,
    empty: np.int32,
    near: np.float32,
    far: np.float32,
    depth: Float32,
    labels: NDArray[np.uint8],
) -> None:
    nan = np.float32(np.nan)
    for y in range(depth.shape[0]):
        for x in range(depth.shape[1]):
            key = keys[y, x]
            z = ONE / np.int32(key & ROUND).view(np.float32)
            z = z if z > near else near
            z = z if z < far else far
            seen = key > empty
            depth[y, x] = z if seen & ((key & 1) == 1) else nan
            labels[y, x] = np.uint8(15 - ((key >> 1) & 15)) if seen else np.uint8(0)


@njit(cache=True, nogil=True, error_model="numpy")
def look_up(
    shades: NDArray[np.uint8],
    across: NDArray[np.uint8],
    down: NDArray[np.uint8],
    texels: NDArray[np.uint8],
    palettes: NDArray[np.uint8],
    rgb: NDArray[np.uint8],
) -> None:
    """Colour `rgb` where the three counts of it say so; see the twin in `plain`."""
    levels = palettes.shape[1]
    for y in range(rgb.shape[0]):
        for x in range(rgb.shape[1]):
            if shades[y, x, 2] > 0:
                u = (np.int64(across[y, x, 0]) + 256 * np.int64(across[y, x, 1])) * texels.shape[1]
                v = (np.int64(down[y, x, 0]) + 256 * np.int64(down[y, x, 1])) * texels.shape[0]
                k = texels[v // levels, u // levels]
                shade = np.int64(shades[y, x, 0]) + 256 * np.int64(shades[y, x, 1])
                for c in range(3):
                    rgb[y, x, c] = palettes[k, shade, c]


@njit(cache=True, nogil=True, error_model="numpy")
def _draw(
    vertices: Float,
    triangles: NDArray[np.int32],
    pose: Float,
    lens: Float,
    near: float,
    keys: Keys,
    stride: int,
    width: int,
    paint: Keys,
    rows: NDArray[np.int32],
    code: int,
    shades: Float32,
    levels: int,
) -> None:
    local = np.empty((vertices.shape[0], 3))
    pixel = np.empty((vertices.shape[0], 3))
    for i in range(vertices.shape[0]):
        x, y, z = vertices[i, 0], vertices[i, 1], vertices[i, 2]
        for k in range(3):
            local[i, k] = pose[k, 0] * x + pose[k, 1] * y + pose[k, 2] * z + pose[k, 3]
        w = 1.0 / local[i, 2]
        pixel[i, 0] = lens[2] + (lens[0] * local[i, 0] + lens[1] * local[i, 1]) * w
        pixel[i, 1] = lens[4] + lens[3] * local[i, 1] * w
        pixel[i, 2] = w
    shaded = paint.size > 0
    s0 = s1 = s2 = 0.0
    cut = np.empty((4, 4))
    corners = np.empty((3, 4))
    for m in range(triangles.shape[0]):
        a, b, c = triangles[m, 0], triangles[m, 1], triangles[m, 2]
        if shaded:
            s0, s1, s2 = float(shades[m, 0]), float(shades[m, 1]), float(shades[m, 2])
        za, zb, zc = local[a, 2], local[b, 2], local[c, 2]
        if za >= near and zb >= near and zc >= near:
            fill(
                pixel[a, 0], pixel[a, 1], pixel[a, 2], s0,
                pixel[b, 0], pixel[b, 1], pixel[b, 2], s1,
                pixel[c, 0], pixel[c, 1], pixel[c, 2], s2,
                keys, stride, width, paint, rows, code, levels,
            )  # fmt: skip
        elif za >= near or zb >= near or zc >= near:
            for k in range(3):
                for axis in range(3):
                    corners[k, axis] = local[triangles[m, k], axis]
            corners[0, 3], corners[1, 3], corners[2, 3] = s0, s1, s2
            n = clip(corners, near, cut)
            for k in range(n):
                w = 1.0 / cut[k, 2]
                cut[k, 0] = lens[2] + (lens[0] * cut[k, 0] + lens[1] * cut[k, 1]) * w
                cut[k, 1] = lens[4] + lens[3] * cut[k, 1] * w
                cut[k, 2] = w
            for k in range(1, n - 1):
                fill(
                    cut[0, 0], cut[0, 1], cut[0, 2], cut[0, 3],
                    cut[k, 0], cut[k, 1], cut[k, 2], cut[k, 3],
                    cut[k + 1, 0], cut[k + 1, 1], cut[k + 1, 2], cut[k + 1, 3],
                    keys, stride, width, paint, rows, code, levels,
                )  # fmt: skip


def corner_shades(mesh: SceneMesh, eye: Float, light: Float) -> Float32:
    """As `shading.corner_shades`."""
    return _corner_shades(mesh.vertices, mesh.triangles, eye, light)


@njit(cache=True, nogil=True, error_model="numpy")
def _corner_shades(v: Float, t: NDArray[np.int32], eye: Float, light: Float) -> Float32:
    faces = np.empty((t.shape[0], 4))
    normals = np.zeros((v.shape[0], 4))
    for m in range(t.shape[0]):
        a, b, c = t[m, 0], t[m, 1], t[m, 2]
        px, py, pz = v[b, 0] - v[a, 0], v[b, 1] - v[a, 1], v[b, 2] - v[a, 2]
        qx, qy, qz = v[c, 0] - v[a, 0], v[c, 1] - v[a, 1], v[c, 2] - v[a, 2]
        x, y, z = py * qz - pz * qy, pz * qx - px * qz, px * qy - py * qx
        for k in range(3):
            i = t[m, k]
            normals[i, 0] += x
            normals[i, 1] += y
            normals[i, 2] += z
        away = x * (v[a, 0] - eye[0]) + y * (v[a, 1] - eye[1]) + z * (v[a, 2] - eye[2])
        length = math.sqrt(x * x + y * y + z * z) + TINY
        faces[m, 0], faces[m, 1], faces[m, 2], faces[m, 3] = (
            x / length, y / length, z / length, away
        )  # fmt: skip
    for i in range(v.shape[0]):
        x, y, z = normals[i, 0], normals[i, 1], normals[i, 2]
        length = math.sqrt(x * x + y * y + z * z) + TINY
        x, y, z = x / length, y / length, z / length
        normals[i, 0], normals[i, 1], normals[i, 2] = x, y, z
        normals[i, 3] = x * light[0] + y * light[1] + z * light[2]
    creased = np.zeros(v.shape[0], np.bool_)
    for m in range(t.shape[0]):
        x, y, z = faces[m, 0], faces[m, 1], faces[m, 2]
        for k in range(3):
            i = t[m, k]
            lean = normals[i, 0] * x + normals[i, 1] * y + normals[i, 2] * z
            if lean < CREASE_COSINE:
                creased[i] = True
    shades = np.empty(t.shape, np.float32)
    for m in range(t.shape[0]):
        x, y, z = faces[m, 0], faces[m, 1], faces[m, 2]
        flat = x * light[0] + y * light[1] + z * light[2]
        for k in range(3):
            i = t[m, k]
            toward = flat if creased[i] else normals[i, 3]
            shades[m, k] = np.float32(toward if faces[m, 3] > 0.0 else -toward)
    return shades
