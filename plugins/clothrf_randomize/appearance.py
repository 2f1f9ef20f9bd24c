"""Light and colour: only features that read colour notice."""

from __future__ import annotations

import colorsys

import numpy as np

from clothrf_core.scene import Light
from clothrf_randomize.config import LightSpread

Colour = tuple[float, float, float]


def vary_light(
    rng: np.random.Generator, nominal: Light, colour: Colour, spread: LightSpread
) -> tuple[Light, Colour]:
    """Another light within a cone about the nominal one, and another shade of the cloth."""
    s = spread.strength
    # Uniform on the cap of the sphere about the nominal direction.
    cap = 1.0 - np.cos(min(np.pi, s * np.radians(spread.direction_deg)))
    cos = 1.0 - cap * rng.uniform()
    turn = rng.uniform(0.0, 2.0 * np.pi)
    gains = 1.0 + s * np.array([spread.intensity, spread.ambient]) * rng.uniform(-1.0, 1.0, 2)
    shade = s * rng.uniform(-1.0, 1.0, 3)
    if s == 0.0:
        return nominal, colour
    axis = np.array(nominal.direction) / np.linalg.norm(nominal.direction)
    side = np.cross(axis, [1.0, 0.0, 0.0] if abs(axis[0]) < 0.9 else [0.0, 1.0, 0.0])
    side /= np.linalg.norm(side)
    up = np.cross(axis, side)
    sin = np.sqrt(max(0.0, 1.0 - cos**2))
    direction = cos * axis + sin * (np.cos(turn) * side + np.sin(turn) * up)
    light = Light(
        direction=(float(direction[0]), float(direction[1]), float(direction[2])),
        intensity=max(0.0, float(nominal.intensity * gains[0])),
        ambient=max(0.0, float(nominal.ambient * gains[1])),
    )
    hue, saturation, value = colorsys.rgb_to_hsv(*colour)
    hue = (hue + shade[0] * spread.hue_deg / 360.0) % 1.0
    saturation = min(1.0, max(0.0, saturation + shade[1] * spread.saturation))
    value = min(1.0, max(0.0, value + shade[2] * spread.value))
    return light, colorsys.hsv_to_rgb(hue, saturation, value)
