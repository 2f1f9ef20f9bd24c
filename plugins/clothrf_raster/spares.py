"""Arrays that are used again as soon as nobody holds them any more.

Pictures are new arrays in every frame, a few megabytes together. Left to the allocator, that much
memory goes back to the system and comes back page by page: 2 ms a frame (measured with glibc, which
trims its heap there), more than the drawing.
"""

from __future__ import annotations

import sys
from typing import Any

import numpy as np
from numpy.typing import DTypeLike, NDArray

# References to an array that only `Spares` holds, as `sys.getrefcount` counts them in `take`: the
# list, the loop variable and the argument.
UNUSED = 3
MOST = 4


class Spares:
    """A few arrays of one shape and dtype.

    A frame's arrays are views of ours and hold them, however they are sliced or passed on; an array
    without such a holder cannot be seen by anybody.
    """

    def __init__(self, shape: tuple[int, ...], dtype: DTypeLike) -> None:
        self._shape = shape
        self._dtype = dtype
        self._arrays: list[NDArray[Any]] = []

    def take(self) -> NDArray[Any]:
        """An array with any contents that nobody else holds."""
        for array in self._arrays:
            if sys.getrefcount(array) <= UNUSED:
                return array
        fresh: NDArray[Any] = np.empty(self._shape, self._dtype)
        if len(self._arrays) < MOST:
            self._arrays.append(fresh)
        return fresh
