"""The state of N cloths of one topology, and the call that moves them."""

from __future__ import annotations

from collections.abc import Sequence
from concurrent.futures import ThreadPoolExecutor

import numpy as np
from numpy.typing import NDArray

from clothrf_core.types import Float
from clothrf_sapien.newton import Effort, Scratch, advance, scratch_for
from clothrf_sapien.schwarz import Plan, plan
from clothrf_sapien.weave import Weave, neighbours


class Cloths:
    """N cloths that share rows, columns and pinned vertices; each has its own fabric and size.

    Any set of vertices can be pinned: the four corners in a `Simulator`, whole edges in tests.

    Attributes:
        x: (N, V, 3) float64 positions, metres, world.
        v: (N, V, 3) float64 velocities, metres a second.
        count: N.
    """

    def __init__(self, weaves: Sequence[Weave], vertices: Float, pins: NDArray[np.int64]) -> None:
        self.count = len(weaves)
        self.x = np.array(vertices, dtype=np.float64)
        self.v = np.zeros_like(self.x)
        self._pins = np.array(pins, dtype=np.int64)
        self._columns = weaves[0].columns
        self._ends = neighbours(self._columns)
        self._sheets = tuple(
            np.stack([getattr(w, name) for w in weaves])
            for name in ("springs", "lengths", "limits", "bending", "mass")
        )
        self._numbers = np.stack([w.numbers for w in weaves])
        self._layers = np.stack([w.layers for w in weaves])
        self._triangles = weaves[0].mesh.triangles.astype(np.int64)
        self._lift = spread(weaves[0], self._pins)
        self._rows = weaves[0].rows
        self._memory = [self._more_memory()]

    def _more_memory(self) -> tuple[Plan, Scratch]:
        """What one thread needs."""
        layered = bool((self._layers[:, 0] > 0.0).any())
        scratch = scratch_for(self.x.shape[1], layered=layered)
        return plan(self._rows, self._columns), scratch

    def advance(
        self,
        targets: Float,
        dt: float,
        *,
        substeps: int,
        iterations: int,
        tolerance: float,
        extra_drag: float = 0.0,
        only: Sequence[int] | None = None,
        threads: int = 1,
    ) -> NDArray[np.int64]:
        """Move the pinned vertices to (N, P, 3) `targets` within `dt` seconds.

        Args:
            targets: (N, P, 3) float64, world.
            dt: seconds.
            substeps: implicit Euler steps.
            iterations: most Newton iterations a substep.
            tolerance: m; Newton stops when its longest move is shorter.
            extra_drag: added to every cloth's drag, 1/s.
            only: the cloths to move; all if None.
            threads: that share the cloths.

        Returns:
            (M, 2) evaluations and factors of each cloth that moved.
        """
        effort = Effort(substeps, iterations, tolerance)
        chosen = np.arange(self.count) if only is None else np.array(only, int)
        parts = [chosen]
        if threads > 1:
            parts = [p for p in np.array_split(chosen, threads) if len(p)]
        while len(self._memory) < len(parts):
            self._memory.append(self._more_memory())

        def work(part: NDArray[np.int64], memory: tuple[Plan, Scratch]) -> NDArray[np.int64]:
            pick = slice(int(part[0]), int(part[-1]) + 1)
            whole = len(part) == pick.stop - pick.start
            where = pick if whole else part
            x, v = self.x[where], self.v[where]
            numbers = self._numbers[where] + np.array([0.0, extra_drag, 0.0])
            sheets = (*(array[where] for array in self._sheets), numbers, self._layers[where])
            goals = targets[where]
            topology = (self._ends, self._columns, self._triangles, self._lift)
            tally = np.zeros((len(part), 2), np.int64)
            advance(x, v, self._pins, goals, sheets, *topology, dt, effort, *memory, tally)
            if not whole:
                self.x[where], self.v[where] = x, v
            return tally

        if len(parts) == 1:
            return work(parts[0], self._memory[0])
        with ThreadPoolExecutor(len(parts)) as pool:
            return np.concatenate(list(pool.map(work, parts, self._memory)))


def spread(weave: Weave, pins: NDArray[np.int64]) -> Float:
    """(P, V) bilinear weights of four pinned corners; zeros where others are pinned.

    Of the grid alone, so that cloths of all sizes in a batch get the same bits.
    """
    rows, columns = weave.rows, weave.columns
    result = np.zeros((len(pins), rows * columns))
    if len(pins) != 4 or not np.array_equal(pins, weave.mesh.corners):
        return result
    row, column = np.divmod(np.arange(rows * columns), columns)
    for p, corner in enumerate(pins):
        r, c = divmod(int(corner), columns)
        along = 1.0 - np.abs(row - r) / (rows - 1)
        result[p] = along * (1.0 - np.abs(column - c) / (columns - 1))
    return result
