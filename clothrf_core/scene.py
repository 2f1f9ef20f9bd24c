"""What there is to be drawn: meshes with labels and colours, and a light.

Every renderer draws the same `Scene`, so their pictures can be compared pixel by pixel.
"""

from __future__ import annotations

import enum
from dataclasses import dataclass, field, replace

import numpy as np
from numpy.typing import NDArray

from clothrf_core.arrays import checked
from clothrf_core.errors import ShapeError
from clothrf_core.types import CameraModel, ClothMesh, ClothState, Float, RgbdFrame, _set

NO_UV = np.zeros((0, 2))


class Label(enum.IntEnum):
    """What a pixel of the label image shows."""

    NOTHING = 0
    CLOTH = 1
    TABLE = 2
    HAND = 3
    GRIPPER = 4
    OCCLUDER = 5
    BACKDROP = 6


@dataclass(frozen=True, slots=True, eq=False)
class Pattern:
    """A small picture of few colours that can be laid on a mesh; keeps copies of its arrays.

    Attributes:
        texels: (h, w) uint8: which colour stands where.
        colours: (K, 3) float64, linear RGB in [0, 1].
    """

    texels: NDArray[np.uint8]
    colours: Float

    def __post_init__(self) -> None:
        _set(
            self,
            texels=checked("Pattern.texels", np.array(self.texels), (None, None), np.uint8),
            colours=checked("Pattern.colours", np.array(self.colours), (None, 3), np.float64),
        )
        if self.texels.size == 0 or int(self.texels.max()) >= len(self.colours):
            raise ShapeError(
                f"Pattern.texels: expected one number or more, all below {len(self.colours)}"
            )


@dataclass(frozen=True, slots=True, eq=False)
class SceneMesh:
    """A triangle mesh, visible from both sides.

    Attributes:
        label: what its pixels are called.
        vertices: (V, 3) float64, metres, world.
        triangles: (M, 3) int32.
        colour: (3,) linear RGB in [0, 1].
        measurable: False for surfaces on which a depth camera reads nothing (bare metal, glass):
            they are drawn and hide what is behind them, and their depth is NaN.
        pattern: what is printed on it instead of `colour`; None = nothing.
        uv: (V, 2) float64 in [0, 1]: where each vertex lies on the pattern, from its left and from
            its upper edge; (0, 2) without a pattern.
    """

    label: Label
    vertices: Float
    triangles: NDArray[np.int32]
    colour: tuple[float, float, float] = (0.7, 0.7, 0.7)
    measurable: bool = True
    pattern: Pattern | None = None
    uv: Float = field(default_factory=lambda: NO_UV)

    def __post_init__(self) -> None:
        places = 0 if self.pattern is None else len(self.vertices)
        _set(
            self,
            vertices=checked("SceneMesh.vertices", self.vertices, (None, 3), np.float64),
            uv=checked("SceneMesh.uv", self.uv, (places, 2), np.float64),
            triangles=checked("SceneMesh.triangles", self.triangles, (None, 3), np.int32),
        )
        if self.triangles.size and int(self.triangles.max()) >= len(self.vertices):
            raise ShapeError(
                f"SceneMesh.triangles: expected indices below {len(self.vertices)}, got "
                f"{int(self.triangles.max())}"
            )

    def looks_like(self, other: SceneMesh) -> bool:
        """Whether both look the same from everywhere."""
        return (
            (self.label, self.measurable, tuple(self.colour))
            == (other.label, other.measurable, tuple(other.colour))
            and self.pattern is other.pattern
            and np.array_equal(self.vertices, other.vertices)
            and np.array_equal(self.triangles, other.triangles)
            and np.array_equal(self.uv, other.uv)
        )

    def copy(self) -> SceneMesh:
        """The same with arrays of its own; the owner of these may write into them."""
        return replace(
            self,
            vertices=np.array(self.vertices),
            triangles=np.array(self.triangles),
            uv=np.array(self.uv),
        )

    def printed(self, pattern: Pattern, uv: Float) -> SceneMesh:
        """The same with `pattern` on it, each vertex at its (V, 2) place `uv`."""
        return replace(self, pattern=pattern, uv=uv)


@dataclass(frozen=True, slots=True, eq=False)
class Light:
    """One directional light and an ambient term (Lambert's law).

    Attributes:
        direction: (3,) unit vector in which the light travels, world.
        intensity: of the directional light, 1 = white surfaces facing it are white.
        ambient: light that reaches every surface.
    """

    direction: tuple[float, float, float] = (-0.3, 0.2, -0.933)
    intensity: float = 0.7
    ambient: float = 0.3


@dataclass(frozen=True, slots=True, eq=False)
class Scene:
    """All meshes of one instant and the light on them.

    Attributes:
        meshes: drawn in any order.
        light: the light.
        background: (3,) linear RGB where nothing is hit.
        stamp_ns: the simulated instant.
    """

    meshes: tuple[SceneMesh, ...]
    light: Light = field(default_factory=Light)
    background: tuple[float, float, float] = (0.05, 0.05, 0.06)
    stamp_ns: int = 0


@dataclass(frozen=True, slots=True, eq=False)
class Picture:
    """What a renderer gives: the frame a camera would see, and what each pixel is.

    Attributes:
        frame: colour and depth; depth is NaN where nothing measurable was hit.
        labels: (H, W) uint8 of `Label` values.
    """

    frame: RgbdFrame
    labels: NDArray[np.uint8]

    def __post_init__(self) -> None:
        _set(
            self,
            labels=checked("Picture.labels", self.labels, self.frame.depth.shape, np.uint8),
        )


def sphere(
    centre: Float,
    radius: float,
    label: Label,
    colour: tuple[float, float, float],
    *,
    segments: int = 10,
) -> SceneMesh:
    """A UV sphere of `radius` metres about `centre` (3,), `segments` rings by 2 `segments`."""
    ring = np.linspace(0.0, np.pi, segments + 1)
    turn = np.linspace(0.0, 2.0 * np.pi, 2 * segments, endpoint=False)
    theta, phi = np.meshgrid(ring, turn, indexing="ij")
    unit = np.stack(
        [np.sin(theta) * np.cos(phi), np.sin(theta) * np.sin(phi), np.cos(theta)], axis=-1
    ).reshape(-1, 3)
    return SceneMesh(
        label=label,
        vertices=np.asarray(centre, float) + radius * unit,
        triangles=_grid_triangles(segments + 1, 2 * segments, wrap=True),
        colour=colour,
    )


def capsule(
    start: Float,
    end: Float,
    radius: float,
    label: Label,
    colour: tuple[float, float, float],
    *,
    segments: int = 8,
) -> SceneMesh:
    """A capsule from `start` to `end` (3,) metres: fingers, arms, occluding rods."""
    axis = np.asarray(end, float) - np.asarray(start, float)
    length = float(np.linalg.norm(axis))
    z = axis / length if length > 1e-9 else np.array([0.0, 0.0, 1.0])
    x = np.cross(z, [1.0, 0.0, 0.0] if abs(z[0]) < 0.9 else [0.0, 1.0, 0.0])
    x /= np.linalg.norm(x)
    y = np.cross(z, x)
    half = np.linspace(0.0, np.pi / 2.0, segments // 2 + 1)
    rings = [(-radius * np.cos(a), radius * np.sin(a)) for a in half]
    rings += [(length + radius * np.sin(a), radius * np.cos(a)) for a in half]
    turn = np.linspace(0.0, 2.0 * np.pi, 2 * segments, endpoint=False)
    circle = np.cos(turn)[:, None] * x + np.sin(turn)[:, None] * y
    vertices = np.concatenate([start + h * z + r * circle for h, r in rings])
    return SceneMesh(
        label=label,
        vertices=vertices,
        triangles=_grid_triangles(len(rings), 2 * segments, wrap=True),
        colour=colour,
    )


def along(mesh: SceneMesh, start: Float, direction: Float) -> SceneMesh:
    """A mesh built along the z axis from the origin, moved to `start` and turned to `direction`.

    Args:
        mesh: a body of revolution about z, for example a `capsule` from the origin upwards.
        start: (3,) where its origin goes, world.
        direction: (3,) unit vector its z axis turns to, world.
    """
    x, y, z = (float(v) for v in direction)
    sign = 1.0 if z >= 0.0 else -1.0  # an orthonormal frame without branches (Duff et al. 2017)
    a = -1.0 / (sign + z)
    b = x * y * a
    R = np.array(
        [[1.0 + sign * x * x * a, sign * b, -sign * x], [b, sign + y * y * a, -y], [x, y, z]]
    )
    return SceneMesh(
        mesh.label, mesh.vertices @ R + start, mesh.triangles, mesh.colour, mesh.measurable
    )


def box(low: Float, high: Float, label: Label, colour: tuple[float, float, float]) -> SceneMesh:
    """An axis-aligned box between two corners (3,), metres, world."""
    corner = np.array([[i, j, k] for i in (0, 1) for j in (0, 1) for k in (0, 1)], float)
    quads = [(0, 1, 3, 2), (4, 6, 7, 5), (0, 4, 5, 1), (2, 3, 7, 6), (0, 2, 6, 4), (1, 5, 7, 3)]
    triangles = [t for a, b, c, d in quads for t in ((a, b, c), (a, c, d))]
    return SceneMesh(
        label=label,
        vertices=np.asarray(low, float) + corner * (np.asarray(high, float) - low),
        triangles=np.array(triangles, np.int32),
        colour=colour,
    )


def cloth_mesh(
    state: ClothState, mesh: ClothMesh, colour: tuple[float, float, float] = (0.1, 0.45, 0.5)
) -> SceneMesh:
    """The cloth of a simulator as something to draw."""
    return SceneMesh(
        label=Label.CLOTH,
        vertices=np.array(state.vertices),
        triangles=mesh.triangles,
        colour=colour,
    )


def _grid_triangles(rows: int, columns: int, *, wrap: bool) -> NDArray[np.int32]:
    i, j = np.meshgrid(
        np.arange(rows - 1), np.arange(columns if wrap else columns - 1), indexing="ij"
    )
    a = i * columns + j
    b = i * columns + (j + 1) % columns
    c, d = a + columns, b + columns
    return np.concatenate(
        [np.stack([a, b, c], -1).reshape(-1, 3), np.stack([b, d, c], -1).reshape(-1, 3)]
    ).astype(np.int32)


def empty_picture(camera: CameraModel, *, stamp_ns: int = 0) -> Picture:
    """A picture in which nothing was hit; a start for renderers and tests."""
    h, w = camera.height, camera.width
    frame = RgbdFrame(
        stamp_ns=stamp_ns,
        rgb=np.zeros((h, w, 3), np.uint8),
        depth=np.full((h, w), np.nan, np.float32),
        camera=camera,
    )
    return Picture(frame=frame, labels=np.zeros((h, w), np.uint8))
