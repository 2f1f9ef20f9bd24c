"""Hands that move between random targets, both under one limit (the paper, section V)."""

from __future__ import annotations

from typing import Literal

import numpy as np
from typing_extensions import override

from clothrf_core.errors import ConfigError
from clothrf_core.interfaces import HandMotion
from clothrf_core.types import Float
from clothrf_tasks.hand_limits import HandLimits

_BATCH = 256
_MOST_DRAWS = 400


class RandomTargets(HandMotion):
    """Straight lines between legal random poses; both hands arrive at the same time.

    Targets are uniform within ``+- reach`` of the rest corners, redrawn until the pair is legal.
    Because both hands interpolate by the same fraction, their difference is a straight line too:
    its length is largest at an end, and it cannot cross sides. So the whole way is legal.
    """

    def __init__(
        self,
        limits: HandLimits,
        *,
        pause: float = 0.0,
        pairing: Literal["independent", "common"] = "independent",
    ) -> None:
        self.limits = limits
        self.pause = pause
        self.pairing = pairing
        self._rng = np.random.default_rng(0)
        self._hands = limits.drawn_together(limits.rest)
        self._target = np.array(self._hands)
        self._waiting = 0.0
        self._arrivals = 0

    @property
    @override
    def arrivals(self) -> int:
        return self._arrivals

    @override
    def reset(self, rng: np.random.Generator) -> Float:
        self._rng = rng
        self._hands = self._draw()
        self._target = self._draw()
        self._waiting = 0.0
        self._arrivals = 0
        return np.array(self._hands)

    @override
    def step(self, dt: float) -> Float:
        left = dt
        while left > 0.0:
            if self._waiting > 0.0:
                spent = min(left, self._waiting)
                self._waiting -= spent
                left -= spent
                continue
            way = self._target - self._hands
            needed = float(np.abs(way).max()) / self.limits.max_speed
            if needed == 0.0 and self.pause == 0.0:
                break
            if needed > left:
                self._hands = self._hands + (left / needed) * way
                break
            left -= needed
            self._hands = self._target
            self._arrivals += 1
            self._target = self._draw()
            self._waiting = self.pause
        return np.array(self._hands)

    def _draw(self) -> Float:
        """(2, 3) a legal pose.

        Raises:
            ConfigError: about 100,000 draws gave none: rest corners, range and distance disagree.
        """
        limits = self.limits
        pairs = 1 if self.pairing == "common" else 2
        rest = limits.drawn_together(limits.rest) if pairs == 1 else limits.rest
        for _ in range(_MOST_DRAWS):
            offsets = self._rng.uniform(-limits.reach, limits.reach, size=(_BATCH, pairs, 3))
            poses = rest + offsets
            legal = np.flatnonzero(limits.legal(poses))
            if legal.size:
                return np.array(poses[legal[0]])
        raise ConfigError(
            f"hands: expected legal targets within {limits.reach} m of the rest corners and at "
            f"most {limits.max_distance} m apart, found none in {_MOST_DRAWS * _BATCH} draws; "
            "widen 'range' or 'max_distance'"
        )
