"""What is printed on cloth, table and backdrop: plain, gradient, chequer, stripes or speckles.

The cloth keeps its hue and the rest keeps off it, so that a cloth found by its colour stays found.
"""

from __future__ import annotations

import colorsys
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from clothrf_core.scene import Label, Pattern, SceneMesh
from clothrf_core.types import CameraModel, Float
from clothrf_randomize.config import TextureSpread

TEXELS = 128
SHADES = 16
KINDS = ("plain", "gradient", "chequer", "stripes", "speckles")
GREY = (0.45, 0.44, 0.42)
Colour = tuple[float, float, float]


@dataclass(frozen=True, slots=True, eq=False)
class Prints:
    """One roll-out's patterns; None = as it was."""

    cloth: Pattern | None = None
    table: Pattern | None = None
    backdrop: SceneMesh | None = None


def draw_prints(
    rng: np.random.Generator, cloth: Colour, camera: CameraModel, spread: TextureSpread
) -> Prints:
    """Patterns around a `cloth` of that linear RGB colour, seen by `camera`."""
    s = spread.strength
    if s == 0.0:
        return Prints()
    kinds = [KINDS[i] for i in rng.integers(0, len(KINDS), 3)]
    surfaces = [
        cloth_shades(rng, cloth, spread),
        ground_shades(rng, cloth, spread),
        ground_shades(rng, cloth, spread),
    ]
    printed, table, behind = (
        Pattern(texels(rng, kind), colours) for kind, colours in zip(kinds, surfaces, strict=True)
    )
    return Prints(
        cloth=None if kinds[0] == "plain" else printed,
        table=table,
        backdrop=backdrop(camera, behind),
    )


def texels(rng: np.random.Generator, kind: str) -> NDArray[np.uint8]:
    """(TEXELS, TEXELS) uint8 shades from 0 to SHADES - 1 of one kind of pattern."""
    i, j = np.mgrid[0:TEXELS, 0:TEXELS] / TEXELS
    turn, phase = rng.uniform(0.0, 2.0 * np.pi), rng.uniform()
    count = int(rng.integers(2, 11))
    along = np.cos(turn) * i + np.sin(turn) * j
    if kind == "gradient":
        share = (along - along.min()) / np.ptp(along)
    elif kind == "chequer":
        share = (np.floor(count * i) + np.floor(count * j)) % 2.0
    elif kind == "stripes":
        share = np.floor(2.0 * count * along + 2.0 * phase) % 2.0
    elif kind == "speckles":
        share = rng.uniform(size=(TEXELS, TEXELS)) ** 3
    else:
        share = np.zeros((TEXELS, TEXELS))
    result: NDArray[np.uint8] = np.rint(share * (SHADES - 1)).astype(np.uint8)
    return result


def backdrop(camera: CameraModel, pattern: Pattern) -> SceneMesh:
    """A wall across the whole picture, 1 % nearer than the far plane; nothing is measured on it."""
    z = 0.99 * camera.far
    # A lens may see a little more than its pinhole would: a tenth of the picture on each side.
    w, h = camera.width, camera.height
    pixels = np.array([[x, y, 1.0] for y in (-0.1 * h, 1.1 * h) for x in (-0.1 * w, 1.1 * w)])
    local = z * pixels @ np.linalg.inv(camera.K).T
    return SceneMesh(
        label=Label.BACKDROP,
        vertices=local @ camera.T_world_camera[:3, :3].T + camera.T_world_camera[:3, 3],
        triangles=np.array([[0, 1, 2], [1, 3, 2]], np.int32),
        measurable=False,
        pattern=pattern,
        uv=np.array([[0.0, 0.0], [1.0, 0.0], [0.0, 1.0], [1.0, 1.0]]),
    )


def cloth_shades(rng: np.random.Generator, cloth: Colour, spread: TextureSpread) -> Float:
    """(SHADES, 3) linear RGB from the cloth's colour to another shade of it."""
    turn, gain = spread.strength * rng.uniform(-1.0, 1.0, 2)
    hue, saturation, value = colorsys.rgb_to_hsv(*cloth)
    other = (
        hue + turn * spread.cloth_hue_deg / 360.0,
        saturation,
        min(1.0, max(0.05, value * (1.0 + gain * spread.cloth))),
    )
    return _between(np.array([hue, saturation, value]), np.array(other))


def ground_shades(rng: np.random.Generator, cloth: Colour, spread: TextureSpread) -> Float:
    """(SHADES, 3) linear RGB from a grey's way to one colour to its way to another.

    The hues are taken from the circle without the cloth's neighbourhood, and so are those between.
    """
    hue, apart = colorsys.rgb_to_hsv(*cloth)[0], spread.keep_off_deg / 360.0
    ends = rng.uniform(size=(2, 3))
    ends[:, 0] = hue + apart + ends[:, 0] * (1.0 - 2.0 * apart)
    way = min(1.0, spread.strength * spread.ground)
    mixed: Float = (1.0 - way) * np.array(GREY) + way * _between(ends[0], ends[1])
    return mixed


def _between(first: Float, last: Float) -> Float:
    """(SHADES, 3) linear RGB from one (3,) hue, saturation and value to another."""
    share = np.linspace(0.0, 1.0, SHADES)[:, None]
    hsv = (1.0 - share) * first + share * last
    return np.array([colorsys.hsv_to_rgb(h % 1.0, s, v) for h, s, v in hsv.tolist()])
