"""A view: the board's points found in one picture. Views are all that the solvers see."""

from __future__ import annotations

import dataclasses
import logging
from collections import Counter
from collections.abc import Callable, Iterable, Sequence
from concurrent.futures import ThreadPoolExecutor
from pathlib import Path

import cv2
import numpy as np
from numpy.typing import NDArray

from clothrf_calibration.boards import Board
from clothrf_calibration.detect import Detection, detect, explain_missing
from clothrf_calibration.errors import BoardNotFound, CalibrationError
from clothrf_calibration.images import read_grey
from clothrf_core.errors import DataError
from clothrf_core.types import Float

logger = logging.getLogger(__name__)

Track = Callable[[Iterable[Path], int], Iterable[Path]]


@dataclasses.dataclass(frozen=True, slots=True, eq=False)
class View:
    """What one picture says.

    Attributes:
        name: the picture's name without extension and without ``_color``.
        size: (width, height) of the picture, pixels.
        ids: (N,) int64 indices into the board's points.
        pixels: (N, 2) float64.
    """

    name: str
    size: tuple[int, int]
    ids: NDArray[np.int64]
    pixels: Float

    def keep(self, mask: NDArray[np.bool_]) -> View:
        """The view without the points where (N,) `mask` is False."""
        return dataclasses.replace(self, ids=self.ids[mask], pixels=self.pixels[mask])


@dataclasses.dataclass(frozen=True, slots=True, eq=False)
class Loaded:
    """The views of a folder, and what was left out.

    Attributes:
        views: pictures with a board.
        skipped: name -> why it has none.
    """

    views: list[View]
    skipped: dict[str, str]


def load_views(
    paths: Sequence[Path],
    board: Board,
    *,
    track: Track | None = None,
    workers: int = 2,
) -> Loaded:
    """Find the board in every picture, on `workers` threads.

    Raises:
        BoardNotFound: it is in none of them; the message says what is there instead.
        CalibrationError: pictures of different sizes.
    """

    def look(path: Path) -> tuple[tuple[int, int] | None, Detection | None, str]:
        try:
            image = read_grey(path)
        except DataError as error:
            return None, None, str(error)
        size = (image.shape[1], image.shape[0])
        return size, detect(board, image), "no board found"

    before = cv2.getNumThreads()
    cv2.setNumThreads(1)
    try:
        with ThreadPoolExecutor(max_workers=workers) as pool:
            jobs = [pool.submit(look, path) for path in paths]
            results = []
            tracked = track(paths, len(paths)) if track is not None else paths
            for _, job in zip(tracked, jobs, strict=True):
                results.append(job.result())
    finally:
        cv2.setNumThreads(before)
    views, skipped = [], {}
    for path, (size, found, reason) in zip(paths, results, strict=True):
        if found is None or size is None:
            skipped[path.name] = reason
            logger.warning("%s is left out: %s", path.name, reason)
        else:
            views.append(View(view_name(path), size, found.ids, found.pixels))
    if not views:
        raise BoardNotFound(_nothing(paths, board, skipped))
    one_size(views)
    return Loaded(views, skipped)


def view_name(path: Path) -> str:
    """Name of the view in the picture `path`."""
    return path.stem.removesuffix("_color")


def one_size(views: Sequence[View]) -> tuple[int, int]:
    """(width, height) of all views.

    Raises:
        CalibrationError: they differ.
    """
    sizes = Counter(v.size for v in views)
    if len(sizes) > 1:
        found = ", ".join(f"{n} of {w} x {h}" for (w, h), n in sizes.most_common())
        raise CalibrationError(
            f"expected pictures of one resolution, found {found}; calibrate each resolution apart"
        )
    return views[0].size


def _nothing(paths: Sequence[Path], board: Board, skipped: dict[str, str]) -> str:
    damaged = [name for name, reason in skipped.items() if reason != "no board found"]
    if len(damaged) == len(paths):
        return f"none of the {len(paths)} pictures can be read; first: {skipped[damaged[0]]}"
    images = [read_grey(p) for p in paths[:12] if p.name not in damaged][:8]
    return (
        f"no board {board.text} found in any of {len(paths)} pictures: "
        f"{explain_missing(board, images)}"
    )
