"""The median of numbers counted in bins, compiled."""

from __future__ import annotations

import numpy as np
from numba import njit
from numpy.typing import NDArray


@njit(cache=True, nogil=True)
def median_bin(count: NDArray[np.int64], total: int) -> float:
    """Where the median of `total` counted numbers lies, in bins, linear within its bin.

    The number of bins if fewer were counted than half of `total`.
    """
    below = 0
    for i in range(count.size):
        if 2 * (below + count[i]) >= total:
            return float(i + (0.5 * total - below) / count[i])
        below += count[i]
    return float(count.size)
