from __future__ import annotations

from pathlib import Path

import cv2
import numpy as np
import pytest
from clothrf_calibration import synthetic
from clothrf_calibration.boardprint import board_picture
from clothrf_calibration.boards import Board, parse_board
from clothrf_calibration.detect import Detection, detect
from clothrf_calibration.errors import BoardNotFound, CalibrationError
from clothrf_calibration.images import read_grey
from clothrf_calibration.lens import project, vector
from clothrf_calibration.views import load_views
from numpy.typing import NDArray

from clothrf_core.errors import DataError
from clothrf_core.types import Float

BOARDS = [
    "charuco:10x7:25mm:18mm:DICT_5X5_100",
    "charuco:10x7:25mm:18mm:DICT_4X4_50:legacy",
    "chessboard:9x6:25mm",
    "circles:9x6:25mm",
    "acircles:4x11:20mm",
]


def photograph(board: Board, T: Float, *, scale: int = 4) -> tuple[NDArray[np.uint8], Float]:
    """A supersampled picture of the board at T_camera_board, and where its points really are."""
    model = synthetic.camera(distortion=())
    sheet, px_per_m, origin = board_picture(board, 2500)
    K = np.diag([scale, scale, 1.0]) @ model.K
    K[:2, 2] += 0.5 * scale - 0.5
    to_board = np.array([[1 / px_per_m, 0, -origin[0]], [0, 1 / px_per_m, -origin[1]], [0, 0, 1.0]])
    H = K @ np.column_stack([T[:3, 0], T[:3, 1], T[:3, 3]]) @ to_board
    big = cv2.warpPerspective(
        src=sheet,
        M=H,
        dsize=(640 * scale, 480 * scale),
        flags=cv2.INTER_LINEAR,
        borderMode=cv2.BORDER_CONSTANT,
        borderValue=255,
    )
    image = cv2.resize(src=big, dsize=(640, 480), interpolation=cv2.INTER_AREA)
    image = cv2.GaussianBlur(src=image, ksize=(0, 0), sigmaX=0.7)  # no lens is sharper
    local = board.points @ T[:3, :3].T + T[:3, 3]
    return np.asarray(image, np.uint8), project(vector(model.K, np.zeros(0)), local)


def found(text: str, *, seed: int = 3, distance: float = 0.45) -> tuple[Detection, Float, Board]:
    board = parse_board(text)
    rng = np.random.default_rng(seed)
    T = synthetic.board_poses(rng, board, 1, tilt=0.5, distance=(distance, distance), spread=0.0)[0]
    image, truth = photograph(board, T)
    detection = detect(board, image)
    assert detection is not None
    return detection, truth, board


@pytest.mark.parametrize("text", BOARDS)
def test_points_of_a_drawn_board_are_found_to_a_twentieth_of_a_pixel(text: str) -> None:
    detection, truth, board = found(text)

    error = np.linalg.norm(detection.pixels - truth[detection.ids], axis=1)
    if board.turnable and error.max() > 10:
        error = np.linalg.norm(detection.pixels - truth[::-1], axis=1)
    assert len(detection.ids) >= 0.95 * len(board.points)
    # Centres of tilted circles are not the centres of their pictures.
    assert np.sqrt((error**2).mean()) < (0.12 if "circles" in text else 0.06)


@pytest.mark.parametrize("seed", [0, 1, 2])
def test_a_chessboard_turned_upside_down_keeps_its_first_corner(seed: int) -> None:
    board = parse_board("chessboard:9x6:25mm")
    rng = np.random.default_rng(seed)
    T = synthetic.board_poses(rng, board, 1, tilt=0.4, distance=(0.5, 0.5), spread=0.0)[0]
    turned = T.copy()
    middle = T[:3, :3] @ board.points.mean(axis=0) + T[:3, 3]
    turned[:3, :3] = np.diag([-1.0, -1.0, 1.0]) @ T[:3, :3]
    turned[:3, 3] = middle - turned[:3, :3] @ board.points.mean(axis=0)

    image, truth = photograph(board, turned)
    detection = detect(board, image)

    assert detection is not None
    assert np.abs(detection.pixels - truth).max() < 0.5


def test_an_empty_picture_has_no_board() -> None:
    for text in BOARDS:
        assert detect(parse_board(text), np.full((480, 640), 127, np.uint8)) is None


def test_a_partly_hidden_charuco_board_gives_what_is_visible() -> None:
    board = parse_board(BOARDS[0])
    rng = np.random.default_rng(1)
    T = synthetic.board_poses(rng, board, 1, tilt=0.3, distance=(0.45, 0.45), spread=0.0)[0]
    image, truth = photograph(board, T)
    image[:, 320:] = 127

    detection = detect(board, image)

    assert detection is not None
    assert 6 <= len(detection.ids) < len(board.points)
    error = np.linalg.norm(detection.pixels - truth[detection.ids], axis=1)
    assert np.median(error) < 0.1
    assert (error < 1.0).mean() > 0.9


def test_the_published_charuco_pictures_are_read_completely(data: Path) -> None:
    moveit = Board(columns=5, rows=7, square=0.02, marker=0.015, dictionary="DICT_5X5_250")
    opencv = Board(columns=5, rows=7, square=0.04, marker=0.02, dictionary="DICT_6X6_250")

    for board, name in (
        (moveit, "moveit_handeye/test_charuco_board_detection.jpg"),
        (opencv, "opencv_charuco/choriginal.jpg"),
    ):
        detection = detect(board, read_grey(data / name))
        assert detection is not None
        assert len(detection.ids) == 24


def test_a_wrong_board_size_is_named_with_the_right_one(data: Path) -> None:
    paths = sorted((data / "opencv_left").glob("*.jpg"))[:3]

    with pytest.raises(BoardNotFound) as caught:
        load_views(paths, parse_board("chessboard:10x7:25mm"))

    assert str(caught.value) == (
        "no board chessboard:10x7:25mm found in any of 3 pictures: a board of 9x6 inner corners "
        "is there instead; pass the size of your board (inner corners, not squares)"
    )


def test_a_wrong_dictionary_is_said(data: Path) -> None:
    paths = [data / "opencv_charuco" / "choriginal.jpg"]

    with pytest.raises(
        BoardNotFound, match=r"markers of another dictionary are there; try DICT_6X6"
    ):
        load_views(paths, parse_board("charuco:5x7:40mm:20mm:DICT_5X5_100"))


def test_pictures_without_a_board_are_said(tmp_path: Path) -> None:
    path = tmp_path / "a.png"
    cv2.imwrite(filename=str(path), img=np.full((480, 640), 99, np.uint8))

    with pytest.raises(BoardNotFound) as caught:
        load_views([path], parse_board("charuco:10x7:25mm"))

    assert str(caught.value) == (
        "no board charuco:10x7:25mm:18mm:DICT_5X5_100 found in any of 1 pictures: no markers are "
        "visible: check that it is a ChArUco board, sharp and evenly lit"
    )


def test_pictures_of_two_resolutions_are_refused(data: Path, tmp_path: Path) -> None:
    source = data / "opencv_left" / "left01.jpg"
    (tmp_path / "a.jpg").write_bytes(source.read_bytes())
    half = cv2.resize(src=read_grey(source), dsize=(320, 240), interpolation=cv2.INTER_AREA)
    cv2.imwrite(filename=str(tmp_path / "b.png"), img=half)

    with pytest.raises(CalibrationError) as caught:
        load_views(sorted(tmp_path.iterdir()), parse_board("chessboard:9x6:25mm"))

    assert str(caught.value) == (
        "expected pictures of one resolution, found 1 of 640 x 480, 1 of 320 x 240; calibrate "
        "each resolution apart"
    )


def test_a_truncated_picture_is_left_out_and_named(data: Path, tmp_path: Path) -> None:
    for name in ("left01.jpg", "left02.jpg"):
        (tmp_path / name).write_bytes((data / "opencv_left" / name).read_bytes())
    cut = tmp_path / "left02.jpg"
    cut.write_bytes(cut.read_bytes()[:9000])

    loaded = load_views(sorted(tmp_path.iterdir()), parse_board("chessboard:9x6:25mm"))

    assert [v.name for v in loaded.views] == ["left01"]
    assert loaded.skipped == {
        "left02.jpg": f"{cut}: expected a whole picture, found a truncated file; delete it"
    }


def test_only_truncated_pictures_are_one_error(tmp_path: Path) -> None:
    path = tmp_path / "a.png"
    path.write_bytes(b"\x89PNG broken")

    with pytest.raises(BoardNotFound, match="none of the 1 pictures can be read; first: "):
        load_views([path], parse_board("chessboard:9x6:25mm"))
    with pytest.raises(DataError, match="expected a whole picture"):
        read_grey(path)
