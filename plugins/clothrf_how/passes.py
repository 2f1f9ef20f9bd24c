"""Wrinkles of one direction, found by two one-dimensional filters over a box of the picture."""

from __future__ import annotations

from dataclasses import dataclass

import cv2
import numpy as np
from numpy.typing import NDArray

from clothrf_core.types import Float, Float32
from clothrf_how import how_kernels as kernels
from clothrf_how.config import HowOptions
from clothrf_how.gabor import Factors
from clothrf_how.lanes import LANES

RESPONSES = {
    "half": kernels.HALF,
    "magnitude": kernels.MAGNITUDE,
    "energy": kernels.ENERGY,
    "saturate8": kernels.SATURATE8,
}


@dataclass(frozen=True, slots=True, eq=False)
class Grid:
    """Which cell each working pixel of the foreground's box falls into.

    Attributes:
        rows: (bh,) int32 cell row, negative = outside the grid.
        columns: (bw,) int32 cell column.
        shape: cell rows and columns.
        first: (row, column) in the box of the first pixel of the grid's even ones.
    """

    rows: NDArray[np.int32]
    columns: NDArray[np.int32]
    shape: tuple[int, int]
    first: tuple[int, int] = (0, 0)

    def turned(self) -> Grid:
        """The grid of the transposed picture."""
        return Grid(self.columns, self.rows, self.shape[::-1], self.first[::-1])


@dataclass(frozen=True, slots=True, eq=False)
class Passes:
    """`gabor.Factors` in the form that the compiled loop takes."""

    along_steps: NDArray[np.int32]
    along_weights: Float32
    across_steps: NDArray[np.int32]
    across_weights: Float32
    quadrature: Float32
    along: tuple[int, int]
    across: tuple[int, int]
    shift: NDArray[np.int32]
    margin: int

    @classmethod
    def of(cls, wave: Factors, quarter: Factors) -> Passes:
        """Of a wave and the same wave a quarter period on."""
        return cls(
            along_steps=np.ascontiguousarray(wave.along[:, 0], dtype=np.int32),
            along_weights=np.ascontiguousarray(wave.along[:, 1], dtype=np.float32),
            across_steps=np.ascontiguousarray(wave.across[:, 0], dtype=np.int32),
            across_weights=np.ascontiguousarray(wave.across[:, 1], dtype=np.float32),
            quadrature=np.ascontiguousarray(quarter.across[:, 1], dtype=np.float32),
            along=wave.along_step,
            across=wave.across_step,
            shift=np.array(wave.shift, np.int32),
            margin=wave.reach() + 1,
        )

    def sums(self, board: Board, turned: Board, options: HowOptions) -> Float:
        """(rows, columns) float64 of the pixels in a box; answers outside the mask do not count.

        With ``every = 2`` the answers of every second row are summed, and of every second column
        for wrinkles that run along the rows: along a wrinkle the answer hardly changes.

        Args:
            board: the picture.
            turned: the transposed one; waves down the columns are waves along its rows.
            options: response and `every`.
        """
        if self.across == (0, 1):
            return self._run(turned, (0, 1), (1, 0), options).T
        return self._run(board, self.along, self.across, options)

    def _run(
        self, board: Board, along: tuple[int, int], across: tuple[int, int], options: HowOptions
    ) -> Float:
        result: Float = kernels.oriented_sums(
            board.picture,
            board.counts,
            board.margin,
            self.along_steps,
            self.along_weights,
            self.across_steps,
            self.across_weights,
            self.quadrature,
            along,
            across,
            self.shift,
            RESPONSES[options.response],
            board.grid.rows,
            board.columns,
            *board.grid.shape,
            board.grid.first[0] if options.every > 1 else 0,
            options.every,
        )
        return result


@dataclass(frozen=True, slots=True, eq=False)
class Board:
    """The box of a picture as the compiled loop takes it, made once for all orientations.

    Attributes:
        picture: (bh + 2 margin, bw + 2 margin and more) float32, zeros around the picture.
        counts: (bh, W) float32, 1 where answers count; W = bw made a multiple of `LANES`.
        columns: (W,) int32 cell columns, negative beyond the box.
        grid: which cell each pixel of the box falls into.
        margin: pixels around the box.
    """

    picture: Float32
    counts: Float32
    columns: NDArray[np.int32]
    grid: Grid
    margin: int

    @classmethod
    def of(
        cls,
        picture: Float32,
        mask: NDArray[np.bool_],
        box: tuple[int, int, int, int],
        grid: Grid,
        margin: int,
    ) -> Board:
        """The half-open `box` of a picture and its mask."""
        w = box[2] - box[0]
        around, counts = kernels.framed(picture, mask, box, margin, -(-w // LANES) * LANES)
        return cls(around, counts, _lengthened(grid.columns, counts.shape[1]), grid, margin)

    def turned(self) -> Board:
        """The same of the transposed picture."""
        h, w = self.grid.rows.size, self.grid.columns.size
        m, wide = self.margin, -(-h // LANES) * LANES
        around = np.zeros((w + 2 * m, wide + 2 * m + LANES), np.float32)
        around[:, : h + 2 * m] = cv2.transpose(src=self.picture[:, : w + 2 * m])
        counts = np.zeros((w, wide), np.float32)
        counts[:, :h] = cv2.transpose(src=self.counts[:, :w])
        grid = self.grid.turned()
        return Board(around, counts, _lengthened(grid.columns, wide), grid, m)


def _lengthened(cells: NDArray[np.int32], size: int) -> NDArray[np.int32]:
    result = np.full(size, -1, np.int32)
    result[: cells.size] = cells
    return result
