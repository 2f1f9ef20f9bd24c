from __future__ import annotations

import json
from pathlib import Path
from typing import Any

import pytest
from clothrf_calibration.boards import Board, parse_board
from clothrf_calibration.images import find_images
from clothrf_calibration.views import View, load_views

DATA = Path(__file__).parents[1] / "data" / "calibration"


@pytest.fixture(scope="session")
def data() -> Path:
    return DATA


@pytest.fixture(scope="session")
def expected() -> Any:
    return json.loads((DATA / "expected.json").read_text())


@pytest.fixture(scope="session")
def left_board() -> Board:
    return parse_board("chessboard:9x6:25mm")


@pytest.fixture(scope="session")
def left_views(left_board: Board) -> list[View]:
    return load_views(find_images(DATA / "opencv_left"), left_board).views
