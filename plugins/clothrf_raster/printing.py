"""Meshes with a pattern: where each seen pixel lies on the pattern, and its colour there.

The engines know one number a corner, the cosine to the light. A mesh with a pattern is drawn three
times over the same picture, with that cosine and with both coordinates on the pattern, in an ink
that counts instead of colouring; the three counts of a pixel give its colour. So plain meshes cost
nothing more, and both engines and bent lenses draw patterns as they are.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import replace

import numpy as np
from numpy.typing import NDArray

from clothrf_core.scene import Pattern, SceneMesh
from clothrf_core.types import Float32
from clothrf_raster.canvas import Canvas, Ink
from clothrf_raster.shading import LEVELS

Draw = Callable[[Canvas, Ink], None]
Bytes = NDArray[np.uint8]
LookUp = Callable[[Bytes, Bytes, Bytes, Bytes, Bytes, Bytes], None]


def counting() -> NDArray[np.uint8]:
    """(LEVELS, 3) uint8 palette whose entry k is k in two bytes, then 1 for "drawn"."""
    k = np.arange(LEVELS)
    return np.stack([k & 255, k >> 8, np.ones_like(k)], axis=1).astype(np.uint8)


def print_mesh(
    draw: Draw,
    look_up: LookUp,
    canvas: Canvas,
    mesh: SceneMesh,
    pattern: Pattern,
    ink: Ink,
    palettes: NDArray[np.uint8],
) -> None:
    """Draw `mesh` with its pattern on `canvas` wherever it is closer than what is there.

    Args:
        draw: draws the mesh on a canvas with an ink.
        look_up: the engine's.
        canvas: with colour.
        mesh: what is drawn.
        pattern: what is printed on it.
        ink: code and (M, 3) shades of the mesh; its palette is not used.
        palettes: (K, LEVELS, 3) uint8: a palette for each of the pattern's colours.
    """
    palette = counting()
    before = np.array(canvas.keys)
    counts = []
    for values in (ink.shades, *_corners(mesh)):
        canvas.keys[:] = before
        layer = replace(canvas, rgb=np.zeros_like(canvas.rgb))
        draw(layer, Ink(ink.code, values, palette))
        counts.append(layer.rgb)
    shades, across, down = counts
    look_up(shades, across, down, pattern.texels, palettes, canvas.rgb)


def _corners(mesh: SceneMesh) -> tuple[Float32, Float32]:
    """(M, 3) float32 left-to-right and top-to-bottom places of each triangle's corners."""
    places = mesh.uv[mesh.triangles].astype(np.float32)
    return np.ascontiguousarray(places[:, :, 0]), np.ascontiguousarray(places[:, :, 1])
