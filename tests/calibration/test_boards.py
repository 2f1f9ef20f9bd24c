from __future__ import annotations

from pathlib import Path

import cv2
import numpy as np
import pytest
from clothrf_calibration.boardprint import board_picture, pdf_page, png_page, write_board
from clothrf_calibration.boards import Board, half_turn, parse_board, read_board
from clothrf_calibration.detect import charuco_board, detect
from clothrf_calibration.errors import CalibrationError
from clothrf_calibration.images import read_grey

TEXTS = [
    "charuco:10x7:25mm:18mm:DICT_5X5_100",
    "charuco:8x6:30mm:22mm:DICT_4X4_50:legacy",
    "chessboard:9x6:25mm",
    "circles:9x6:20mm",
    "acircles:4x11:20mm",
]


@pytest.mark.parametrize("text", TEXTS)
def test_a_board_line_reads_back_as_itself(text: str) -> None:
    assert parse_board(text).text == text


def test_charuco_points_are_opencvs() -> None:
    board = parse_board(TEXTS[0])

    assert np.allclose(board.points, charuco_board(board).getChessboardCorners(), atol=1e-7)


def test_a_half_turn_maps_the_points_onto_themselves_reversed() -> None:
    board = parse_board("circles:9x6:20mm")

    mapped = board.points @ half_turn(board)[:3, :3].T + half_turn(board)[:3, 3]

    assert np.allclose(mapped, board.points[::-1])


@pytest.mark.parametrize("text", TEXTS)
def test_the_printed_page_is_read_back_at_true_scale(text: str, tmp_path: Path) -> None:
    board = parse_board(text)
    paths = write_board(board, tmp_path, dpi=200)

    image = read_grey(next(p for p in paths if p.suffix == ".png"))
    detection = detect(board, image)

    assert detection is not None
    assert len(detection.ids) == len(board.points)
    pixel = 0.0254 / 200
    metres = detection.pixels * pixel
    a, b = board.points[detection.ids[0]], board.points[detection.ids[-1]]
    assert np.linalg.norm(metres[-1] - metres[0]) == pytest.approx(
        float(np.linalg.norm(b - a)), abs=1e-4
    )


def test_the_file_names_hold_the_size(tmp_path: Path) -> None:
    names = {p.name for p in write_board(parse_board(TEXTS[0]), tmp_path)}

    assert names == {
        "charuco_10x7_25mm_18mm_DICT_5X5_100_A4.pdf",
        "charuco_10x7_25mm_18mm_DICT_5X5_100_A4.png",
        "charuco_10x7_25mm_18mm_DICT_5X5_100.board.toml",
    }


def test_the_board_file_reads_back(tmp_path: Path) -> None:
    board = parse_board(TEXTS[1])
    write_board(board, tmp_path)

    assert read_board(next(tmp_path.glob("*.board.toml"))) == board


def test_an_existing_board_of_the_same_name_is_not_written_again(tmp_path: Path) -> None:
    board = parse_board(TEXTS[2])
    path = next(p for p in write_board(board, tmp_path) if p.suffix == ".toml")
    path.write_text(path.read_text() + "# measured by hand\n")

    write_board(board, tmp_path)

    assert "measured by hand" in path.read_text()


def test_the_pdf_page_has_the_papers_size_and_vector_squares() -> None:
    data = pdf_page(parse_board(TEXTS[2]), "A4")

    assert data.startswith(b"%PDF-1.4")
    assert b"/MediaBox [0 0 841.890 595.276]" in data
    assert data.rstrip().endswith(b"%%EOF")
    # 10 x 7 squares, half of them black, each one rectangle of 25 mm = 70.866 points.
    assert data.count(b"70.866 70.866 re") == 35


def test_the_png_page_carries_its_resolution() -> None:
    data = png_page(parse_board(TEXTS[2]), "A4", dpi=300)

    at = data.index(b"pHYs") + 4
    assert int.from_bytes(data[at : at + 4], "big") == 11811


def test_a_board_that_does_not_fit_the_page_is_refused() -> None:
    with pytest.raises(CalibrationError) as caught:
        pdf_page(parse_board("chessboard:9x6:40mm"), "A4")

    assert str(caught.value) == (
        "board chessboard:9x6:40mm: expected at most 277 x 181 mm on A4, found 400 x 280 mm; "
        "take smaller squares or --paper A3"
    )


@pytest.mark.parametrize(
    ("text", "message"),
    [
        ("chess:9x6:25mm", "board 'chess:9x6:25mm': kind: Input should be 'charuco'"),
        ("chessboard:9:25mm", "board 'chessboard:9:25mm': expected a board file"),
        ("charuco:10x7:25mm:30mm", "expected less than the square's 25 mm, got 30 mm"),
        ("nowhere.toml", "nowhere.toml: expected a board file, found none"),
    ],
)
def test_a_wrong_board_line_says_what_is_wrong(text: str, message: str) -> None:
    with pytest.raises(CalibrationError) as caught:
        parse_board(text)

    assert message in str(caught.value)


def test_too_small_a_dictionary_is_refused() -> None:
    with pytest.raises(CalibrationError) as caught:
        charuco_board(parse_board("charuco:12x9:20mm:15mm:DICT_5X5_50"))

    assert str(caught.value) == (
        "board: 12x9 squares need 54 markers, DICT_5X5_50 has 50; take a larger dictionary"
    )


def test_a_charuco_picture_is_opencvs() -> None:
    board = Board(columns=5, rows=7, square=0.03, marker=0.02, dictionary="DICT_4X4_50")

    picture, scale, _ = board_picture(board, 1000)
    reference = charuco_board(board).generateImage(outSize=(600, 840), marginSize=0)

    h, w = round(0.21 * scale), round(0.15 * scale)
    margin = round((picture.shape[1] - w) / 2)
    top = round((picture.shape[0] - h) / 2)
    mine = cv2.resize(
        src=picture[top : top + h, margin : margin + w],
        dsize=(600, 840),
        interpolation=cv2.INTER_AREA,
    )
    assert (np.abs(mine.astype(int) - reference) > 100).mean() < 0.01
