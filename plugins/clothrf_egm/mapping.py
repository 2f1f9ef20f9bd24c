"""Joint order and units: the chain 1, 2, 7, 3, 4, 5, 6 in radians against EGM's axes in degrees."""

from __future__ import annotations

import numpy as np

from clothrf_core.types import Float

# Where axes 1 to 6, then axis 7, stand in the chain.
CHAIN = np.array([0, 1, 3, 4, 5, 6, 2])


def to_egm(chain: Float) -> tuple[tuple[float, ...], tuple[float, ...]]:
    """(axes 1 to 6, axis 7) in degrees from (7,) radians along the chain; speeds likewise."""
    degrees = np.degrees(chain)[CHAIN].tolist()
    return tuple(degrees[:6]), tuple(degrees[6:])


def from_egm(joints: tuple[float, ...], external: tuple[float, ...]) -> Float:
    """(7,) radians along the chain from axes 1 to 6 and axis 7 in degrees."""
    chain = np.empty(7)
    chain[CHAIN] = np.radians([*joints, *external])
    return chain
