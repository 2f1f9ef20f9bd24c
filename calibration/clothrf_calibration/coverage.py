"""Which parts of the picture, which tilts and which distances the views cover."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from clothrf_calibration.views import View
from clothrf_core.types import Float

CELLS = (6, 8)
ENOUGH = 0.8
TILT_SPREAD = 20.0
ROLL_SPREAD = 30.0
DISTANCE_SPREAD = 1.4


@dataclass(frozen=True, slots=True, eq=False)
class Coverage:
    """What a set of views shows.

    Attributes:
        cells: (6, 8) int64 corners in each cell of the picture.
        tilts: (V,) degrees between board normal and optical axis.
        spread: largest angle between two board normals, degrees.
        roll: spread of the board's turn about the optical axis, degrees, in [0, 180].
        distances: (V,) metres from the camera to the middle of the board.
    """

    cells: NDArray[np.int64]
    tilts: Float
    spread: float
    roll: float
    distances: Float

    @property
    def share(self) -> float:
        """Share of the cells that hold corners."""
        return float((self.cells > 0).mean())


def cell_counts(views: Sequence[View], size: tuple[int, int]) -> NDArray[np.int64]:
    """(6, 8) int64 corners in each cell of the picture."""
    rows, columns = CELLS
    counts = np.zeros(CELLS, np.int64)
    for view in views:
        j = np.clip((view.pixels[:, 0] + 0.5) / size[0] * columns, 0, columns - 1).astype(int)
        i = np.clip((view.pixels[:, 1] + 0.5) / size[1] * rows, 0, rows - 1).astype(int)
        np.add.at(counts, (i, j), 1)
    return counts


def coverage(views: Sequence[View], T_camera_board: Float, points: Float) -> Coverage:
    """Coverage of `views` with (V, 4, 4) board poses and (P, 3) board points."""
    normals = T_camera_board[:, :3, 2]
    cosines = np.clip(normals @ normals.T, -1.0, 1.0)
    middle = points.mean(axis=0)
    centres = T_camera_board[:, :3, :3] @ middle + T_camera_board[:, :3, 3]
    turns = np.arctan2(T_camera_board[:, 1, 0], T_camera_board[:, 0, 0])
    apart = np.abs((turns[:, None] - turns[None] + np.pi) % (2 * np.pi) - np.pi)
    return Coverage(
        cells=cell_counts(views, views[0].size),
        tilts=np.degrees(np.arccos(np.clip(np.abs(normals[:, 2]), 0.0, 1.0))),
        spread=float(np.degrees(np.arccos(cosines.min()))),
        roll=float(np.degrees(apart.max())),
        distances=np.linalg.norm(centres, axis=1),
    )


def advice(seen: Coverage) -> list[str]:
    """What to photograph next, most useful first; empty if nothing is missing."""
    say = []
    if len(seen.tilts) < 15:
        say.append(f"{15 - len(seen.tilts)} more pictures")
    if seen.spread < TILT_SPREAD:
        say.append(
            f"tilt the board more: its normals differ by {seen.spread:.0f} degrees at most, "
            "40 or more are good"
        )
    if seen.share < ENOUGH:
        say.append(f"bring the board to the {_empty_places(seen.cells)} of the picture")
    if seen.roll < ROLL_SPREAD:
        say.append("turn the board (or the camera) by 90 degrees about the optical axis once")
    if len(seen.distances) > 1 and np.ptp(seen.distances) > 0:
        ratio = float(seen.distances.max() / seen.distances.min())
        if ratio < DISTANCE_SPREAD:
            say.append("vary the distance: the farthest view at twice the nearest")
    return say


def meter(cells: NDArray[np.int64]) -> list[str]:
    """The cell map as lines of text for a terminal."""
    marks = " .:+#"
    return ["".join(marks[min(int(np.ceil(n / 4)), 4)] * 2 for n in row) for row in cells]


def _empty_places(cells: NDArray[np.int64]) -> str:
    empty = cells == 0
    rows, columns = cells.shape
    places = {
        "top left": empty[: rows // 3, : columns // 3],
        "top": empty[: rows // 3, columns // 3 : -(columns // 3)],
        "top right": empty[: rows // 3, -(columns // 3) :],
        "left": empty[rows // 3 : -(rows // 3), : columns // 3],
        "middle": empty[rows // 3 : -(rows // 3), columns // 3 : -(columns // 3)],
        "right": empty[rows // 3 : -(rows // 3), -(columns // 3) :],
        "bottom left": empty[-(rows // 3) :, : columns // 3],
        "bottom": empty[-(rows // 3) :, columns // 3 : -(columns // 3)],
        "bottom right": empty[-(rows // 3) :, -(columns // 3) :],
    }
    ranked = sorted(places, key=lambda name: -float(places[name].mean()))
    chosen = [name for name in ranked if places[name].mean() >= 0.5][:3] or ranked[:1]
    return ", ".join(chosen)
