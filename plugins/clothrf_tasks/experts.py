"""The paper's three experts: x* as a function of the hands (Jia et al. 2018, section IV)."""

from __future__ import annotations

import math
from dataclasses import dataclass
from typing import Literal

import numpy as np
from typing_extensions import override

from clothrf_core.interfaces import Expert
from clothrf_core.types import Action, ClothState
from clothrf_tasks.directions import directions

# The printed constants of the twist, metres, for the printed cloth of 0.35 m.
PAPER_FORWARD = 0.31
PAPER_HALF = 0.15
PAPER_LENGTH = 0.35


@dataclass(frozen=True, slots=True)
class Straight(Expert):
    """Hold the cloth flat: ``r_i = h_i + L c``.

    Attributes:
        length: L, metres.
        eps: see `directions`.
    """

    length: float = 0.35
    eps: float = 0.01

    @override
    def label(self, state: ClothState) -> Action:
        c = directions(state, eps=self.eps).c
        return Action(targets=state.hands + self.length * c)


@dataclass(frozen=True, slots=True)
class Bent(Expert):
    """Let the cloth hang in an arc: ``r_i = h_i + (L / 2) c``.

    Attributes:
        length: L, metres.
        share: chord over length; the paper's is one half.
        eps: see `directions`.
    """

    length: float = 0.35
    share: float = 0.5
    eps: float = 0.01

    @override
    def label(self, state: ClothState) -> Action:
        c = directions(state, eps=self.eps).c
        return Action(targets=state.hands + self.share * self.length * c)


@dataclass(frozen=True, slots=True)
class Twisted(Expert):
    """Twist the cloth by a quarter turn: ``r_0,1 = m + a c +- b n``.

    ``feasible``: b = D / 2 and ``a = sqrt(L^2 - D^2 / 2)``, so that both side edges are L long and
    the grippers as far apart as the hands (D). ``paper``: the printed a = 0.31 m, b = 0.15 m, which
    stretch the sides by 7.3 % at D = 0.30 m; they scale with L / 0.35 m.

    Attributes:
        length: L, metres.
        twist: which of the two.
        eps: see `directions`.
    """

    length: float = 0.35
    twist: Literal["feasible", "paper"] = "feasible"
    eps: float = 0.01

    @override
    def label(self, state: ClothState) -> Action:
        frame = directions(state, eps=self.eps)
        if self.twist == "paper":
            scale = self.length / PAPER_LENGTH
            forward, half = PAPER_FORWARD * scale, PAPER_HALF * scale
        else:
            # Hands farther apart than sqrt(2) L leave less room than D / 2 for a quarter turn.
            room = max(0.0, self.length**2 - 0.25 * frame.distance**2)
            half = min(0.5 * frame.distance, math.sqrt(room))
            forward = math.sqrt(max(0.0, room - half * half))
        centre = frame.middle + forward * frame.c
        return Action(targets=np.stack([centre + half * frame.n, centre - half * frame.n]))
