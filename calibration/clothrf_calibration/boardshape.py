"""How a printed board deviates from the drawing: flat, curved, or every point for itself."""

from __future__ import annotations

from typing import Literal

import numpy as np

from clothrf_calibration.boards import Board
from clothrf_core.types import Float

Shape = Literal["flat", "warp", "free"]

SHAPES: tuple[Shape, ...] = ("flat", "warp", "free")

# What a printer and a bent sheet may plausibly do to one point, metres.
FREE_SIGMA = 5e-4


def shape_size(board: Board, shape: Shape) -> int:
    """How many numbers describe the deviation."""
    return {"flat": 0, "warp": 2, "free": 3 * len(board.points)}[shape]


def shape_basis(board: Board, shape: Shape) -> Float:
    """(P, 3, B) derivatives of the points by the B numbers of the deviation.

    ``warp``: z = a (1 - x^2) + b (1 - y^2) with x, y in [-1, 1] over the board, a and b in metres
    (the parabolic board of mrcal 2.x). ``free``: an offset for every point.
    """
    points = board.points
    if shape == "flat":
        return np.zeros((len(points), 3, 0))
    if shape == "warp":
        basis = np.zeros((len(points), 3, 2))
        low, high = points[:, :2].min(axis=0), points[:, :2].max(axis=0)
        unit = 2.0 * (points[:, :2] - low) / (high - low) - 1.0
        basis[:, 2, :] = 1.0 - unit**2
        return basis
    return np.eye(3 * len(points)).reshape(len(points), 3, -1)


def deformed(board: Board, basis: Float, numbers: Float) -> Float:
    """(P, 3) points of the board as it really is."""
    result: Float = board.points + basis @ numbers
    return result


def deviation(board: Board, basis: Float, numbers: Float) -> tuple[float, float]:
    """Largest out-of-plane and in-plane deviation, metres, after the best rigid fit."""
    real, drawn = deformed(board, basis, numbers), board.points
    a, b = drawn - drawn.mean(axis=0), real - real.mean(axis=0)
    U, _, Vt = np.linalg.svd(a.T @ b)
    R = Vt.T @ np.diag([1.0, 1.0, np.linalg.det(Vt.T @ U.T)]) @ U.T
    rest = b @ R - a
    return float(np.ptp(rest[:, 2])), float(np.linalg.norm(rest[:, :2], axis=1).max())
