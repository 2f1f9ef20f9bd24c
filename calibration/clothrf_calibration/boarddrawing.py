"""What is black on a board: rectangles and discs in the board frame, metres."""

from __future__ import annotations

from dataclasses import dataclass

import cv2
import numpy as np
from numpy.typing import NDArray

from clothrf_calibration.boards import Board
from clothrf_calibration.detect import charuco_board
from clothrf_core.types import Float

CIRCLE_RADIUS = {"circles": 0.3, "acircles": 0.45}


@dataclass(frozen=True, slots=True, eq=False)
class Drawing:
    """Black on white.

    Attributes:
        rectangles: (R, 4) x0, y0, x1, y1.
        discs: (D, 3) x, y, radius.
        low: (2,) top-left corner of the printed area.
        high: (2,) its bottom-right corner.
    """

    rectangles: Float
    discs: Float
    low: Float
    high: Float


def drawing(board: Board) -> Drawing:
    """The black parts of `board`.

    Raises:
        CalibrationError: its dictionary is unknown or too small.
    """
    s, none = board.square, np.zeros((0, 4))
    if board.kind == "charuco":
        low, high = np.zeros(2), s * np.array([board.columns, board.rows], float)
        return Drawing(np.concatenate(_charuco(board)), np.zeros((0, 3)), low, high)
    if board.kind == "chessboard":
        j, i = np.meshgrid(np.arange(board.columns + 1), np.arange(board.rows + 1))
        black = (i + j) % 2 == 0
        corner = s * (np.stack([j[black], i[black]], axis=1) - 1.0)
        rectangles = np.concatenate([corner, corner + s], axis=1)
        return Drawing(
            rectangles, np.zeros((0, 3)), np.full(2, -s), s * np.array([board.columns, board.rows])
        )
    radius = CIRCLE_RADIUS[board.kind] * s
    centres = board.points[:, :2]
    discs = np.concatenate([centres, np.full((len(centres), 1), radius)], axis=1)
    return Drawing(none, discs, centres.min(axis=0) - s / 2, centres.max(axis=0) + s / 2)


def rectangles_of(grid: NDArray[np.bool_], corner: Float, cell: float) -> Float:
    """(R, 4) rectangles of the true cells of a (rows, columns) grid, runs in a row merged."""
    found = []
    for i, row in enumerate(grid):
        edges = np.flatnonzero(np.diff(np.concatenate([[0], row.astype(int), [0]])))
        for j0, j1 in edges.reshape(-1, 2):
            found.append([j0 * cell, i * cell, j1 * cell, (i + 1) * cell])
    return np.array(found, float).reshape(-1, 4) + np.tile(corner, 2)


def _charuco(board: Board) -> list[Float]:
    made = charuco_board(board)
    dictionary = made.getDictionary()
    cells = dictionary.markerSize + 2
    white = np.zeros((board.rows, board.columns), bool)
    parts = []
    for number, corners in zip(np.ravel(made.getIds()), made.getObjPoints(), strict=True):
        corner = np.asarray(corners, float)[:, :2].min(axis=0)
        j, i = np.floor(corner / board.square).astype(int)
        white[i, j] = True
        bits = cv2.aruco.generateImageMarker(
            dictionary=dictionary, id=int(number), sidePixels=cells
        )
        parts.append(rectangles_of(np.asarray(bits) < 128, corner, board.marker_side / cells))
    parts.append(_squares(~white, board.square))
    return parts


def _squares(grid: NDArray[np.bool_], side: float) -> Float:
    i, j = np.nonzero(grid)
    corner = side * np.stack([j, i], axis=1).astype(float)
    return np.concatenate([corner, corner + side], axis=1)
