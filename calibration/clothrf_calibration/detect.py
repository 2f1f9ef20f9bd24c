"""Finds the points of a board in a picture, to a small fraction of a pixel.

The size of the sub-pixel window is the largest single source of error of a calibration: a window
that reaches the next corner pulls every point towards it, which shifts the focal length by percent
and hardly shows in the residual. Here every point gets the largest window that stays clear of its
neighbours.
"""

from __future__ import annotations

import dataclasses
from collections import Counter
from collections.abc import Sequence

import cv2
import numpy as np
from numpy.typing import NDArray

from clothrf_calibration.boards import Board
from clothrf_calibration.errors import CalibrationError
from clothrf_core.errors import suggestion
from clothrf_core.types import Float

MIN_POINTS = 6
SEARCH_WIDTH = 1000
WINDOW = (2, 11)
DETECTOR = "adaptive sub-pixel window (spacing/3, 2..11 px)"


@dataclasses.dataclass(frozen=True, slots=True, eq=False)
class Detection:
    """Points of the board found in one picture.

    Attributes:
        ids: (N,) int64 indices into `Board.points`.
        pixels: (N, 2) float64.
    """

    ids: NDArray[np.int64]
    pixels: Float


def detect(board: Board, image: NDArray[np.uint8]) -> Detection | None:
    """The board in a grey (H, W) uint8 picture, or None; partial views count if ChArUco."""
    if board.kind == "charuco":
        return _charuco(board, image)
    pixels = _grid(board, image)
    if pixels is None:
        return None
    return Detection(np.arange(len(pixels)), pixels)


def refine(image: NDArray[np.uint8], pixels: Float, neighbours: Float) -> Float:
    """(N, 2) corners refined, each with the largest window clear of its (N,) px neighbour."""
    half = np.clip(np.floor(neighbours / 3.0), *WINDOW).astype(int)
    result = np.array(pixels, float)
    criteria = (cv2.TERM_CRITERIA_EPS + cv2.TERM_CRITERIA_MAX_ITER, 60, 1e-4)
    for size in np.unique(half):
        chosen = half == size
        corners = np.ascontiguousarray(pixels[chosen].reshape(-1, 1, 2), np.float32)
        cv2.cornerSubPix(
            image=image,
            corners=corners,
            winSize=(int(size), int(size)),
            zeroZone=(-1, -1),
            criteria=criteria,
        )
        moved = corners.reshape(-1, 2).astype(float)
        far = np.linalg.norm(moved - pixels[chosen], axis=1) > size
        moved[far] = pixels[chosen][far]
        result[chosen] = moved
    return result


def spacing(pixels: Float) -> Float:
    """(N,) distance of every point to its nearest neighbour, pixels."""
    apart = np.linalg.norm(pixels[:, None] - pixels[None], axis=-1)
    np.fill_diagonal(apart, np.inf)
    return np.asarray(apart.min(axis=1))


def explain_missing(board: Board, images: Sequence[NDArray[np.uint8]]) -> str:
    """Why `board` is in none of the pictures, as far as a few trials can tell."""
    if board.kind == "charuco":
        return _explain_charuco(board, images)
    trials = [
        board.model_copy(update={"columns": c, "rows": r})
        for c in range(board.columns - 2, board.columns + 3)
        for r in range(board.rows - 2, board.rows + 3)
        if (c, r) != (board.columns, board.rows) and c >= 3 and r >= 3
    ]
    for image in images[:2]:
        there = [t for t in trials if _grid(t, image, quick=True) is not None]
        if not there:
            continue
        # A part of a board passes for a smaller one.
        c, r = max(((t.columns, t.rows) for t in there), key=lambda size: size[0] * size[1])
        unit = "inner corners" if board.kind == "chessboard" else "circles"
        return (
            f"a board of {c}x{r} {unit} is there instead; pass the size of your board "
            "(inner corners, not squares)"
        )
    return "check that the whole board is visible, flat, sharp and evenly lit, and its kind"


def _grid(board: Board, image: NDArray[np.uint8], *, quick: bool = False) -> Float | None:
    scale = max(1.0, image.shape[1] / SEARCH_WIDTH)
    small = image
    if scale > 1.0:
        size = (round(image.shape[1] / scale), round(image.shape[0] / scale))
        small = np.asarray(
            cv2.resize(src=image, dsize=size, interpolation=cv2.INTER_AREA), np.uint8
        )
    if board.kind != "chessboard":
        return _circles(board, image, small)
    found = _corners(board, small, quick=quick)
    if found is None:
        return None
    ratio = np.array([image.shape[1] / small.shape[1], image.shape[0] / small.shape[0]])
    pixels: Float = (found + 0.5) * ratio - 0.5
    if quick:
        return pixels
    pixels = refine(image, pixels, spacing(pixels))
    return _first_square_black(board, image, pixels)


def _corners(board: Board, image: NDArray[np.uint8], *, quick: bool) -> Float | None:
    size = (board.columns, board.rows)
    flags = cv2.CALIB_CB_ADAPTIVE_THRESH | cv2.CALIB_CB_NORMALIZE_IMAGE
    if quick:
        flags |= cv2.CALIB_CB_FAST_CHECK
    ok, corners = cv2.findChessboardCorners(image=image, patternSize=size, flags=flags)
    if not ok and not quick:
        ok, corners = cv2.findChessboardCornersSB(
            image=image, patternSize=size, flags=cv2.CALIB_CB_NORMALIZE_IMAGE
        )
    if not ok or corners is None or len(corners) != board.columns * board.rows:
        return None
    return np.asarray(corners, float).reshape(-1, 2)


def _first_square_black(board: Board, image: NDArray[np.uint8], pixels: Float) -> Float:
    """Turns the order by 180 degrees where the colours of the squares say so."""
    if board.turnable:
        return pixels
    grid = pixels.reshape(board.rows, board.columns, 2)
    centres = 0.25 * (grid[:-1, :-1] + grid[1:, :-1] + grid[:-1, 1:] + grid[1:, 1:])
    i, j = np.indices(centres.shape[:2])
    column = np.clip(np.round(centres[..., 0]).astype(int), 0, image.shape[1] - 1)
    row = np.clip(np.round(centres[..., 1]).astype(int), 0, image.shape[0] - 1)
    grey = image[row, column].astype(float)
    even = (i + j) % 2 == 0
    return pixels if grey[even].mean() < grey[~even].mean() else pixels[::-1].copy()


def _circles(board: Board, image: NDArray[np.uint8], small: NDArray[np.uint8]) -> Float | None:
    flag = cv2.CALIB_CB_SYMMETRIC_GRID if board.kind == "circles" else cv2.CALIB_CB_ASYMMETRIC_GRID
    for picture in (small, image) if small is not image else (image,):
        parameters = cv2.SimpleBlobDetector.Params()
        parameters.maxArea = 0.02 * picture.size
        parameters.minArea = 12.0
        parameters.minDistBetweenBlobs = 4.0
        parameters.filterByConvexity = True
        parameters.minConvexity = 0.9
        ok, centres = cv2.findCirclesGrid(
            image=picture,
            patternSize=(board.columns, board.rows),
            flags=flag | cv2.CALIB_CB_CLUSTERING,
            blobDetector=cv2.SimpleBlobDetector.create(parameters),
            parameters=cv2.CirclesGridFinderParameters(),
        )
        if ok and centres is not None:
            ratio = np.array([image.shape[1] / picture.shape[1], image.shape[0] / picture.shape[0]])
            pixels = (np.asarray(centres, float).reshape(-1, 2) + 0.5) * ratio - 0.5
            return _centroids(image, pixels)
    return None


def _centroids(image: NDArray[np.uint8], pixels: Float) -> Float:
    """Grey-weighted centres of dark discs; blob detectors round to about a tenth of a pixel."""
    near = spacing(pixels)
    result = np.array(pixels)
    for n, (x, y) in enumerate(pixels):
        half = int(np.clip(0.48 * near[n], 3, 200))
        x0, y0 = max(round(x) - half, 0), max(round(y) - half, 0)
        patch = image[y0 : round(y) + half + 1, x0 : round(x) + half + 1].astype(float)
        low, high = np.percentile(patch, (5, 95))
        if high - low < 20:
            continue
        weight = np.clip((0.75 * high + 0.25 * low - patch) / (0.5 * (high - low)), 0.0, 1.0)
        v, u = np.indices(patch.shape)
        weight[np.hypot(u + x0 - x, v + y0 - y) > half] = 0.0
        total = weight.sum()
        moved = np.array([(weight * u).sum() / total + x0, (weight * v).sum() / total + y0])
        if np.linalg.norm(moved - pixels[n]) < 0.25 * half:
            result[n] = moved
    return result


def _charuco(board: Board, image: NDArray[np.uint8]) -> Detection | None:
    parameters = cv2.aruco.DetectorParameters()
    parameters.cornerRefinementMethod = cv2.aruco.CORNER_REFINE_NONE
    charuco = cv2.aruco.CharucoParameters()
    charuco.minMarkers = 1
    detector = cv2.aruco.CharucoDetector(
        board=charuco_board(board), charucoParams=charuco, detectorParams=parameters
    )
    corners, ids, _, _ = detector.detectBoard(image=image)
    if ids is None or len(ids) < MIN_POINTS:
        return None
    order = np.argsort(np.ravel(ids))
    numbers = np.ravel(ids)[order].astype(np.int64)
    pixels = np.asarray(corners, float).reshape(-1, 2)[order]
    inside = (
        (pixels > 3.0).all(axis=1)
        & (pixels[:, 0] < image.shape[1] - 4)
        & (pixels[:, 1] < image.shape[0] - 4)
    )
    numbers, pixels = numbers[inside], pixels[inside]
    if len(numbers) < MIN_POINTS or _collinear(board.points[numbers, :2]):
        return None
    # The markers' corners, not the next chessboard corner, are what a window must keep clear of.
    gap = 1.5 * (board.square - board.marker_side) / board.square
    clear = spacing(pixels) * min(1.0, max(gap, 0.4))
    pixels = refine(image, pixels, clear)
    predicted, good = _by_neighbours(board.points[numbers, :2], pixels)
    if not good.all():
        # OpenCV's interpolation slips to a marker's corner now and then: look again nearby.
        pixels[~good] = refine(image, predicted[~good], clear[~good])
        _, good = _by_neighbours(board.points[numbers, :2], pixels)
    if good.sum() < MIN_POINTS or _collinear(board.points[numbers[good], :2]):
        return None
    return Detection(numbers[good], pixels[good])


def _by_neighbours(points: Float, pixels: Float) -> tuple[Float, NDArray[np.bool_]]:
    """Where the nearest eight corners, mapped by a homography, put each one; and who agrees.

    At the edge of something that hides a part of the board, corners are found that are none.
    """
    predicted, good = np.array(pixels), np.ones(len(points), bool)
    for n in range(len(points)):
        order = np.argsort(np.linalg.norm(points - points[n], axis=1))[1:9]
        if len(order) < 6 or _collinear(points[order]):
            continue
        H, _ = cv2.findHomography(
            srcPoints=points[order], dstPoints=pixels[order], method=cv2.LMEDS
        )
        if H is None:
            continue
        mapped = H @ [points[n, 0], points[n, 1], 1.0]
        predicted[n] = mapped[:2] / mapped[2]
        apart = float(np.linalg.norm(predicted[n] - pixels[n]))
        step = float(np.linalg.norm(pixels[order[0]] - pixels[n]))
        good[n] = apart < max(2.0, 0.08 * step)
    return predicted, good


def charuco_board(board: Board) -> cv2.aruco.CharucoBoard:
    """OpenCV's object for a ChArUco board.

    Raises:
        CalibrationError: no such dictionary, or it has too few markers.
    """
    known = [name for name in dir(cv2.aruco) if name.startswith("DICT_")]
    if board.dictionary not in known:
        raise CalibrationError(
            f"board: no dictionary called '{board.dictionary}'. "
            f"{suggestion(board.dictionary, known)}"
        )
    dictionary = cv2.aruco.getPredefinedDictionary(getattr(cv2.aruco, board.dictionary))
    needed, there = board.columns * board.rows // 2, len(dictionary.bytesList)
    if needed > there:
        raise CalibrationError(
            f"board: {board.columns}x{board.rows} squares need {needed} markers, "
            f"{board.dictionary} has {there}; take a larger dictionary"
        )
    made = cv2.aruco.CharucoBoard(
        size=(board.columns, board.rows),
        squareLength=board.square,
        markerLength=board.marker_side,
        dictionary=dictionary,
    )
    made.setLegacyPattern(legacyPattern=board.legacy)
    return made


def _explain_charuco(board: Board, images: Sequence[NDArray[np.uint8]]) -> str:
    swapped = board.model_copy(update={"legacy": not board.legacy})
    if any(_charuco(swapped, image) is not None for image in images[:8]):
        say = "remove" if board.legacy else "add"
        return f"the board is of the {'new' if board.legacy else 'legacy'} layout; {say} ':legacy'"
    turned = board.model_copy(update={"columns": board.rows, "rows": board.columns})
    if board.columns != board.rows and any(_charuco(turned, i) is not None for i in images[:8]):
        return f"a board of {turned.columns}x{turned.rows} squares is there; swap the two numbers"
    votes: Counter[str] = Counter()
    for name in ("DICT_4X4_1000", "DICT_5X5_1000", "DICT_6X6_1000", "DICT_7X7_1000",
                 "DICT_ARUCO_ORIGINAL", "DICT_APRILTAG_36h11"):  # fmt: skip
        detector = cv2.aruco.ArucoDetector(
            dictionary=cv2.aruco.getPredefinedDictionary(getattr(cv2.aruco, name))
        )
        for image in images[:4]:
            _, ids, _ = detector.detectMarkers(image=image)
            votes[name] += 0 if ids is None else len(ids)
    name, count = votes.most_common(1)[0]
    if count < 3:
        return "no markers are visible: check that it is a ChArUco board, sharp and evenly lit"
    family = name.removesuffix("_1000")
    if not board.dictionary.startswith(family):
        return f"markers of another dictionary are there; try {family}_..."
    return "its markers are there but do not fit the layout; check the number of squares"


def _collinear(points: Float) -> bool:
    centred = points - points.mean(axis=0)
    return bool(np.linalg.svd(centred, compute_uv=False)[-1] < 1e-6 * max(1.0, len(points)))
