"""What is drawn on: a signed depth buffer, labels and, on demand, colour."""

from __future__ import annotations

from dataclasses import dataclass, field

import numpy as np
from numpy.typing import NDArray

from clothrf_core.types import Float32


@dataclass(frozen=True, slots=True, eq=False)
class Canvas:
    """Writable pictures of one size.

    Attributes:
        depth: (H, W) float32 metres. `empty` where nothing was drawn; negative where the surface
            seen gives no depth reading (it still hides what lies behind).
        labels: (H, W) uint8.
        rgb: (H, W, 3) uint8, or (0, 0, 3) where colour is off.
        empty: float32 just beyond the far plane, so that a closer surface always wins.
    """

    depth: Float32
    labels: NDArray[np.uint8]
    rgb: NDArray[np.uint8]
    empty: np.float32

    @classmethod
    def blank(cls, width: int, height: int, far: float, *, colour: bool) -> Canvas:
        """A canvas of that size with nothing drawn yet."""
        canvas = cls(
            depth=np.empty((height, width), np.float32),
            labels=np.empty((height, width), np.uint8),
            rgb=np.empty((height, width, 3) if colour else (0, 0, 3), np.uint8),
            empty=np.nextafter(np.float32(far), np.float32(np.inf)),
        )
        canvas.clear(np.zeros(3, np.uint8))
        return canvas

    def clear(self, background: NDArray[np.uint8]) -> None:
        """Draw nothing on (3,) `background`."""
        self.depth.fill(self.empty)
        self.labels.fill(0)
        self.rgb[:] = background


@dataclass(frozen=True, slots=True, eq=False)
class Ink:
    """How one mesh is drawn.

    Attributes:
        label: value written into `Canvas.labels`.
        measurable: False makes the depth negative.
        shades: (M, 3) float32 cosine between light and normal at each triangle's corners, signed,
            or (0, 3) where colour is off.
        palette: (L, 3) uint8 colour for L cosines from 0 to 1.
    """

    label: int
    measurable: bool
    shades: Float32 = field(default_factory=lambda: np.zeros((0, 3), np.float32))
    palette: NDArray[np.uint8] = field(default_factory=lambda: np.zeros((1, 3), np.uint8))
