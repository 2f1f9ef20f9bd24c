"""Adam with decoupled weight decay (Kingma, Ba 2015; Loshchilov, Hutter 2019), in numpy."""

from __future__ import annotations

from collections.abc import Collection, Mapping

import numpy as np

from clothrf_core.types import Float32


class Adam:
    """Steps for a set of named arrays; remembers the moments of their gradients.

    Args:
        weights: the arrays whose shapes it will see.
        rate: step size.
        decay: weight decay a step over `rate`.
        decayed: names of the arrays that decay.
    """

    def __init__(
        self,
        weights: Mapping[str, Float32],
        *,
        rate: float,
        decay: float = 0.0,
        decayed: Collection[str] = (),
    ) -> None:
        self._rate = rate
        self._decay = {name: decay if name in decayed else 0.0 for name in weights}
        self._first = {name: np.zeros_like(array) for name, array in weights.items()}
        self._second = {name: np.zeros_like(array) for name, array in weights.items()}
        self._count = 0

    def step(
        self, weights: Mapping[str, Float32], gradient: Mapping[str, Float32]
    ) -> dict[str, Float32]:
        """New arrays one step down `gradient`; the given ones are not changed."""
        self._count += 1
        scale1 = 1.0 / (1.0 - 0.9**self._count)
        scale2 = 1.0 / (1.0 - 0.999**self._count)
        result = {}
        for name, array in weights.items():
            g = gradient[name]
            first, second = self._first[name], self._second[name]
            first += np.float32(0.1) * (g - first)
            second += np.float32(0.001) * (g * g - second)
            step = np.float32(scale1) * first / (np.sqrt(np.float32(scale2) * second) + 1e-8)
            step += np.float32(self._decay[name]) * array
            result[name] = (array - np.float32(self._rate) * step).astype(np.float32)
        return result
