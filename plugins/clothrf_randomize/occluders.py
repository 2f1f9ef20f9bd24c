"""Things between the camera and the cloth that hide a chosen share of it."""

from __future__ import annotations

from typing import NamedTuple

import numpy as np

from clothrf_core.geometry import apply, inverse
from clothrf_core.params import SimulationParams
from clothrf_core.scene import Label, SceneMesh, capsule
from clothrf_core.types import CameraModel, Float
from clothrf_randomize.config import Occluders

# Points across and along the cloth at which cover is counted.
_ACROSS, _ALONG = 32, 36


class Bar(NamedTuple):
    """A strip that faces the camera: all points nearer than `radius` to a segment.

    Attributes:
        start: (2,) float64 end of the segment, m, on the plane at `depth` before the camera.
        end: (2,) float64 other end.
        radius: half its width, m; 0 hides nothing.
        depth: along the optical axis, m.
        plate: a flat rectangle; otherwise a capsule.
    """

    start: Float
    end: Float
    radius: float
    depth: float
    plate: bool


def draw_occluders(
    rng: np.random.Generator,
    camera: CameraModel,
    simulation: SimulationParams,
    spread: Occluders,
) -> tuple[SceneMesh, ...]:
    """Random capsules and plates that together hide a share of the cloth from `camera`.

    The cloth is taken to be the bilinear patch between its four corners at the start; while it
    moves, and where it sags, the hidden share changes. In mode "uniform" the number is U{0..count}
    and the share U(0, strength share); "fixed" always hides strength times share.
    """
    fixed = spread.episode == "fixed"
    count = spread.count if fixed else int(rng.integers(0, spread.count + 1))
    share = spread.strength * spread.share * (1.0 if fixed else rng.uniform())
    if count == 0 or share <= 0.0:
        return ()
    points = apply(inverse(camera.T_world_camera), patch(simulation))
    bars = [_random_bar(rng, points, spread) for _ in range(count)]
    needed = np.sort(needed_radius(points, bars))
    # At most as wide as half a metre, should bars stand beside or behind the cloth.
    radius = min(float(needed[int(min(share, 0.95) * len(needed))]), 0.5)
    colours = rng.uniform(0.05, 0.6, size=(count, 3))
    return tuple(
        _mesh(
            bar._replace(radius=radius * bar.radius), camera, colour, measurable=spread.measurable
        )
        for bar, colour in zip(bars, colours, strict=True)
    )


def patch(simulation: SimulationParams) -> Float:
    """(P, 3) world points of the bilinear patch between hands and grasp."""
    s, t = np.meshgrid(
        (np.arange(_ACROSS) + 0.5) / _ACROSS, (np.arange(_ALONG) + 0.5) / _ALONG, indexing="ij"
    )
    s, t = s.reshape(-1, 1), t.reshape(-1, 1)
    hands = (1.0 - s) * simulation.hands[0] + s * simulation.hands[1]
    grasp = (1.0 - s) * simulation.grasp[0] + s * simulation.grasp[1]
    result: Float = (1.0 - t) * hands + t * grasp
    return result


def needed_radius(points: Float, bars: list[Bar]) -> Float:
    """(P,) factor of the bars' half-widths from which each camera-frame point is hidden."""
    needed = np.full(len(points), np.inf)
    for bar in bars:
        seen = points[:, :2] * (bar.depth / points[:, 2:3])
        along = bar.end - bar.start
        share = np.clip((seen - bar.start) @ along / float(along @ along), 0.0, 1.0)
        gap = np.linalg.norm(seen - bar.start - share[:, None] * along, axis=1)
        behind = points[:, 2] > bar.depth
        needed = np.where(behind, np.minimum(needed, gap / bar.radius), needed)
    return needed


def _random_bar(rng: np.random.Generator, points: Float, spread: Occluders) -> Bar:
    """A bar of unit half-width through a random point of the cloth, as the camera sees it."""
    behind = points[int(rng.integers(len(points)))]
    way = rng.uniform(min(spread.near, spread.far), max(spread.near, spread.far))
    depth = float(way * behind[2])
    centre = behind[:2] * way
    angle = rng.uniform(0.0, np.pi)
    # Half-lengths at the occluder's depth; a long one reaches across the whole cloth.
    reach = way * rng.uniform(0.02, 0.30)
    along = reach * np.array([np.cos(angle), np.sin(angle)])
    return Bar(
        start=centre - along,
        end=centre + along,
        radius=float(way * rng.uniform(0.5, 1.5)),
        depth=depth,
        plate=bool(rng.uniform() < 0.5),
    )


def _mesh(bar: Bar, camera: CameraModel, colour: Float, *, measurable: bool) -> SceneMesh:
    """The bar in the world: a capsule, or a plate with the same outline but square ends."""
    tint = (float(colour[0]), float(colour[1]), float(colour[2]))
    ends = np.array([[*bar.start, bar.depth], [*bar.end, bar.depth]])
    if not bar.plate:
        start, end = apply(camera.T_world_camera, ends)
        made = capsule(start, end, bar.radius, Label.OCCLUDER, tint)
        vertices, triangles = np.array(made.vertices), made.triangles
    else:
        along = (bar.end - bar.start) / np.linalg.norm(bar.end - bar.start)
        across = np.array([-along[1], along[0]])
        # Square ends cover as much as the round ones: pi / 4 of the radius beyond the segment.
        cap = 0.25 * np.pi * bar.radius * along
        flat = np.stack(
            [
                bar.start - cap - bar.radius * across,
                bar.end + cap - bar.radius * across,
                bar.end + cap + bar.radius * across,
                bar.start - cap + bar.radius * across,
            ]
        )
        local = np.column_stack([flat, np.full(4, bar.depth)])
        vertices = apply(camera.T_world_camera, local)
        triangles = np.array([[0, 1, 2], [0, 2, 3]], np.int32)
    return SceneMesh(
        label=Label.OCCLUDER,
        vertices=vertices,
        triangles=triangles,
        colour=tint,
        measurable=measurable,
    )
