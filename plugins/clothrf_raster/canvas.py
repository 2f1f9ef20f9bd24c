"""What is drawn on: one number a pixel that holds inverse depth and label, and colour on demand.

A key is the bit pattern of a positive float32 inverse depth (1/m), rounded to a multiple of 32,
plus five bits that say what is seen: (15 - label) * 2 + measurable. Bit patterns of positive
floats are ordered like the floats, so "the closest surface wins" is the larger of two integers,
which processors do eight at a time; of equally close surfaces the lower label wins, in whatever
order they are drawn. The rounding is at most 2^-19 of the depth: 0.002 mm at 1 m.
"""

from __future__ import annotations

from dataclasses import dataclass, field

import numpy as np
from numpy.typing import NDArray

from clothrf_core.errors import ShapeError
from clothrf_core.types import Float32

Keys = NDArray[np.int32]

HALF = np.int32(16)
ROUND = np.int32(-32)
LARGEST_LABEL = 15
BLOCK = 8


@dataclass(frozen=True, slots=True, eq=False)
class Canvas:
    """Writable pictures of one size.

    Attributes:
        keys: (H, W rounded up to a multiple of 8) int32, see above; `empty` or less = nothing.
        rgb: (H, W, 3) uint8, contiguous, or (0, 0, 3) where colour is off.
        empty: largest key beyond the far plane.
        width: W.
        paint: as `keys`, or (0, 0) where colour is off: scratch of a mesh while it is being drawn,
            1 + the palette's entry where it is seen, 0 elsewhere and between meshes.
        rows: (H, 2) int32: columns [first, end) of `paint` that are in use; [W, 0) = none.
    """

    keys: Keys
    rgb: NDArray[np.uint8]
    empty: np.int32
    width: int
    paint: Keys
    rows: NDArray[np.int32]

    @classmethod
    def blank(cls, width: int, height: int, far: float, *, colour: bool) -> Canvas:
        """A canvas of that size with nothing drawn yet."""
        padded = -(-width // BLOCK) * BLOCK
        canvas = cls(
            keys=np.empty((height, padded), np.int32),
            rgb=np.empty((height, width, 3) if colour else (0, 0, 3), np.uint8),
            empty=np.int32(int(key_of(np.float32(1.0 / far), 0)) - 1),
            width=width,
            paint=np.zeros((height, padded) if colour else (0, 0), np.int32),
            rows=np.tile(np.array([width, 0], np.int32), (height, 1)),
        )
        canvas.clear(np.zeros(3, np.uint8))
        return canvas

    @property
    def words(self) -> NDArray[np.uint32]:
        """The memory of `rgb`, four pixels in three words; (0,) if a row is no whole number."""
        if self.width % 4:
            return np.zeros(0, np.uint32)
        return self.rgb.reshape(-1).view(np.uint32)

    def clear(self, background: NDArray[np.uint8]) -> None:
        """Draw nothing on (3,) `background`."""
        self.keys.fill(self.empty)
        self.rgb[:] = background


@dataclass(frozen=True, slots=True, eq=False)
class Ink:
    """How one mesh is drawn.

    Attributes:
        code: the last five bits of its keys, see `code_of`.
        shades: (M, 3) float32 cosine between light and normal at each triangle's corners, signed,
            or (0, 3) where colour is off.
        palette: (L, 3) uint8 colour for L cosines from 0 to 1.
    """

    code: int
    shades: Float32 = field(default_factory=lambda: np.zeros((0, 3), np.float32))
    palette: NDArray[np.uint8] = field(default_factory=lambda: np.zeros((1, 3), np.uint8))


def code_of(label: int, *, measurable: bool) -> int:
    """The five bits of a surface; a surface without depth reading has an even code.

    Raises:
        ShapeError: the label does not fit.
    """
    if not 0 <= label <= LARGEST_LABEL:
        raise ShapeError(f"label: expected 0 to {LARGEST_LABEL} for the raster camera, got {label}")
    return 2 * (LARGEST_LABEL - label) + int(measurable)


def key_of(inverse_depth: np.float32, code: int) -> np.int32:
    """The key of one surface point; for scalars, the engines do the same with arrays."""
    return np.int32(((inverse_depth.view(np.int32) + HALF) & ROUND) | np.int32(code))
