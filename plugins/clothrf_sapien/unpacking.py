"""From the one picture that our shaders write to colour, depth and labels."""

from __future__ import annotations

import numpy as np
from numba import njit
from numpy.typing import NDArray

from clothrf_core.types import Float32


@njit(cache=True, nogil=True)
def unpack(
    packed: NDArray[np.uint32],
    background: NDArray[np.uint8],
    rgb: NDArray[np.uint8],
    depth: Float32,
    labels: NDArray[np.uint8],
) -> None:
    """Write (H, W, 3) colour, (H, W) depth in metres or NaN, and (H, W) labels.

    Args:
        packed: (H, W, 4) uint32; first red, green, blue and code as four bytes from the lowest,
            then the bits of the float32 depth. Codes are labels, plus 128 for surfaces without
            depth reading; 0 where nothing was hit.
        background: (3,) colour where nothing was hit.
        rgb: written.
        depth: written.
        labels: written.
    """
    nan = np.float32(np.nan)
    for y in range(packed.shape[0]):
        for x in range(packed.shape[1]):
            surface = packed[y, x, 0]
            code = surface >> 24
            label = np.uint8(code & 127)
            labels[y, x] = label
            measured = (label > 0) & (code < 128)
            depth[y, x] = np.uint32(packed[y, x, 1]).view(np.float32) if measured else nan
            for k in range(3):
                rgb[y, x, k] = (surface >> (8 * k)) & 255 if label > 0 else background[k]
