"""What both hands must keep to: how far apart, how fast, which is left."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from clothrf_core.errors import ConfigError
from clothrf_core.provider import BuildContext
from clothrf_core.types import Float
from clothrf_tasks.config import HandsConfig


@dataclass(frozen=True, slots=True, eq=False)
class HandLimits:
    """Where hands may be and how they may move.

    Attributes:
        rest: (2, 3) float64 rest corners, world, m.
        reach: (3,) float64 half-width of targets about the rest corners per axis, m.
        max_distance: of the two hands, m.
        max_speed: per axis, m/s.
    """

    rest: Float
    reach: Float
    max_distance: float
    max_speed: float

    def legal(self, hands: Float) -> np.bool_ | np.ndarray:
        """(...,) whether each of (..., 2, 3) `hands` is near enough together and not crossed.

        Crossed means: along the line of the rest corners (on the ground plan), hand 1 is not on
        its own side of hand 0.
        """
        d = hands[..., 1, :] - hands[..., 0, :]
        side = self.rest[1, :2] - self.rest[0, :2]
        near = np.sum(d * d, axis=-1) <= self.max_distance**2
        result: np.bool_ | np.ndarray = near & (d[..., :2] @ side > 0.0)
        return result

    def drawn_together(self, hands: Float) -> Float:
        """(2, 3) `hands`, moved towards their middle if they are too far apart."""
        d = hands[1] - hands[0]
        distance = float(np.linalg.norm(d))
        if distance <= self.max_distance:
            return np.array(hands)
        # A hair inside, so that rounding does not break the limit.
        half = 0.5 * (1.0 - 1e-12) * self.max_distance / distance * d
        middle = hands.mean(axis=0)
        return np.stack([middle - half, middle + half])


def hand_limits(
    config: HandsConfig, context: BuildContext, *, reach: list[float] | None = None
) -> HandLimits:
    """Limits from the config, and from the context's rig where the config is silent.

    Raises:
        ConfigError: neither of them says it.
    """
    rig = None if context.rig is None else context.rig.hands
    rest = config.rest or (rig.rest if rig else None)
    if rest is None:
        raise ConfigError(
            "hands.rest: expected 2 x 3 rest corners, found neither in the section nor a rig; "
            "name a rig or give 'rest'"
        )
    return HandLimits(
        rest=np.array(rest, float),
        reach=np.array(reach or (rig.range if rig else [0.1, 0.1, 0.1]), float),
        max_distance=config.max_distance or (rig.max_distance if rig else 0.30),
        max_speed=config.max_speed or (rig.max_speed if rig else 0.10),
    )
