"""The randomiser that changes nothing."""

from __future__ import annotations

import numpy as np
from typing_extensions import override

from clothrf_core.interfaces import Randomizer
from clothrf_core.params import Randomization
from clothrf_core.types import RgbdFrame


class Identity(Randomizer):
    """Every roll-out is the nominal one and the sensor is perfect."""

    @override
    def draw(self, rng: np.random.Generator, nominal: Randomization) -> Randomization:
        return nominal

    @override
    def corrupt(
        self, frame: RgbdFrame, params: Randomization, rng: np.random.Generator
    ) -> RgbdFrame:
        return frame
