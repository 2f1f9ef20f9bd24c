"""One thread's drawing board: keeps buffers, and does not draw again what has not changed.

Meshes are always drawn in the same order (backdrop, table, occluders, then the rest). The picture
after the leading unchanged meshes is kept, and later frames start from that copy: the same bits as
drawing everything.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, field, replace
from typing import Protocol

import numpy as np
from numpy.typing import NDArray

from clothrf_core.scene import Label, Pattern, Scene, SceneMesh
from clothrf_core.types import CameraModel, Float, Float32
from clothrf_raster import shading
from clothrf_raster.bend import Bend
from clothrf_raster.canvas import Canvas, Ink, Keys, code_of
from clothrf_raster.printing import print_mesh
from clothrf_raster.spares import Spares
from clothrf_raster.view import View

STILL = (Label.BACKDROP, Label.TABLE, Label.OCCLUDER)
Colour = tuple[float, float, float]


class Engine(Protocol):
    """What draws: the module `compiled` or its twin `plain`."""

    def draw(self, canvas: Canvas, view: View, mesh: SceneMesh, ink: Ink, /) -> None:
        """Draw `mesh` wherever it is closer than what is on the canvas."""

    def finish(
        self, canvas: Canvas, view: View, depth: Float32, labels: NDArray[np.uint8], /
    ) -> None:
        """Write metres or NaN into `depth` and labels into `labels`, both (H, W)."""

    def look_up(
        self,
        shades: NDArray[np.uint8],
        across: NDArray[np.uint8],
        down: NDArray[np.uint8],
        texels: NDArray[np.uint8],
        palettes: NDArray[np.uint8],
        rgb: NDArray[np.uint8],
        /,
    ) -> None:
        """Colour `rgb` (H, W, 3) where the three counts of it say so, see `printing`."""

    def corner_shades(self, mesh: SceneMesh, eye: Float, light: Float, /) -> Float32:
        """(M, 3) cosines to the light, see `shading`."""


@dataclass(slots=True, eq=False)
class Drawing:
    """Buffers for one camera and one light.

    Attributes:
        engine: what draws.
        view: the camera as numbers.
        key: of the camera and light that it was made for.
        light: (3,) unit vector in which the light travels.
        shine: ambient and directional strength.
        background: (3,) uint8.
        eye: (3,) position of the camera, world.
        base: the picture of `kept`.
        work: keys of everything.
        black: (H, W, 3) uint8 zeros, the colour picture where colour is off.
        depths: (H, W) float32 arrays for pictures.
        labels: (H, W) uint8 arrays for pictures.
        colours: (H, W, 3) uint8 arrays for pictures.
        seen: still meshes of the frame before (copies: their owner may write into the arrays).
        kept: how many of `seen` are drawn in `base`.
        palettes: colour of a mesh -> its shades.
    """

    engine: Engine
    view: View
    key: tuple[object, ...]
    light: Float
    shine: tuple[float, float]
    background: NDArray[np.uint8]
    eye: Float
    base: Canvas
    work: Keys
    black: NDArray[np.uint8]
    depths: Spares
    labels: Spares
    colours: Spares
    seen: list[SceneMesh] = field(default_factory=list)
    kept: int = 0
    palettes: dict[Colour, NDArray[np.uint8]] = field(default_factory=dict)

    @classmethod
    def board(
        cls, engine: Engine, scene: Scene, camera: CameraModel, bend: Bend, *, colour: bool
    ) -> Drawing:
        """An empty board for `camera`, whose lens bends as told, under the light of `scene`."""
        direction = np.asarray(scene.light.direction, float)
        size = (camera.width, camera.height, camera.far)
        background = shading.encode(np.asarray(scene.background, float))
        base = Canvas.blank(*size, colour=colour)
        base.clear(background)
        return cls(
            engine=engine,
            view=View.of(camera, bend),
            key=board_key(scene, camera, colour=colour),
            light=direction / np.linalg.norm(direction),
            shine=(scene.light.ambient, scene.light.intensity),
            background=background,
            eye=np.array(camera.T_world_camera[:3, 3]),
            base=base,
            work=np.empty_like(base.keys),
            black=np.zeros((camera.height, camera.width, 3), np.uint8),
            depths=Spares((camera.height, camera.width), np.float32),
            labels=Spares((camera.height, camera.width), np.uint8),
            colours=Spares(base.rgb.shape, np.uint8),
        )

    def draw(self, scene: Scene) -> Canvas:
        """All meshes of `scene`: new colour; the keys are valid until the next call."""
        meshes = sorted(scene.meshes, key=_rank)
        still = meshes[: sum(mesh.label in STILL for mesh in meshes)]
        same = _leading_equal(still, self.seen)
        if same != self.kept:
            self.base.clear(self.background)
            for mesh in still[:same]:
                self._draw_on(self.base, mesh)
            self.kept = same
        if same < max(len(still), len(self.seen)):
            self.seen = self.seen[:same] + [mesh.copy() for mesh in still[same:]]
        np.copyto(self.work, self.base.keys)
        rgb = self.colours.take()
        np.copyto(rgb, self.base.rgb)
        canvas = replace(self.base, keys=self.work, rgb=rgb)
        for mesh in meshes[same:]:
            self._draw_on(canvas, mesh)
        return canvas

    def _draw_on(self, canvas: Canvas, mesh: SceneMesh) -> None:
        code = code_of(int(mesh.label), measurable=mesh.measurable)
        if canvas.rgb.size > 0:
            shades = self.engine.corner_shades(mesh, self.eye, self.light)
            if mesh.pattern is not None:
                self._print_on(canvas, mesh, mesh.pattern, Ink(code, shades))
                return
            ink = Ink(code, shades, self._palette(mesh.colour))
        else:
            ink = Ink(code)
        self.engine.draw(canvas, self.view, mesh, ink)

    def _print_on(self, canvas: Canvas, mesh: SceneMesh, pattern: Pattern, ink: Ink) -> None:
        palettes = np.stack([self._palette((r, g, b)) for r, g, b in pattern.colours.tolist()])

        def draw(layer: Canvas, counting: Ink) -> None:
            self.engine.draw(layer, self.view, mesh, counting)

        print_mesh(draw, self.engine.look_up, canvas, mesh, pattern, ink, palettes)

    def _palette(self, colour: Colour) -> NDArray[np.uint8]:
        key = (colour[0], colour[1], colour[2])
        if key not in self.palettes:
            if len(self.palettes) >= 64:
                self.palettes.clear()
            self.palettes[key] = shading.palette(key, *self.shine)
        return self.palettes[key]


def board_key(scene: Scene, camera: CameraModel, *, colour: bool) -> tuple[object, ...]:
    """Equal for scenes and cameras that can share a board."""
    light = scene.light
    lit = (*light.direction, light.intensity, light.ambient, *scene.background) if colour else ()
    size = (camera.width, camera.height, camera.near, camera.far, camera.distortion.tobytes())
    return (*size, camera.K.tobytes(), camera.T_world_camera.tobytes(), colour, lit)


def _rank(mesh: SceneMesh) -> int:
    return STILL.index(mesh.label) if mesh.label in STILL else len(STILL)


def _leading_equal(meshes: Sequence[SceneMesh], others: Sequence[SceneMesh]) -> int:
    for count, (a, b) in enumerate(zip(meshes, others, strict=False)):
        if not a.looks_like(b):
            return count
    return min(len(meshes), len(others))
