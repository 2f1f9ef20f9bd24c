"""Calibration boards: what is printed, and where its points are.

Board frame (OpenCV 4.6 and later): origin at the top-left of the board, x right, y down, z into
the board. ChArUco points are the inner corners, counted from the outer border of the board;
chessboard and circle grids start at their first point.
"""

from __future__ import annotations

import tomllib
from pathlib import Path
from typing import Annotated, Literal

import numpy as np
from pydantic import Field, ValidationError, model_validator

from clothrf_calibration.errors import CalibrationError
from clothrf_core.rig import Section
from clothrf_core.types import Float

Kind = Literal["charuco", "chessboard", "circles", "acircles"]
Count = Annotated[int, Field(ge=2, le=60)]


class Board(Section):
    """A planar calibration board.

    `columns` and `rows` count what OpenCV counts: squares of a ChArUco board, inner corners of a
    chessboard, circles of a grid (of an asymmetric grid: circles in a row, and rows).
    """

    kind: Kind = Field("charuco", description="charuco, chessboard, circles or acircles")
    columns: Count = Field(10, description="squares (charuco), inner corners or circles")
    rows: Count = Field(7, description="squares (charuco), inner corners or circles")
    square: float = Field(0.025, gt=0.0, lt=2.0, description="side or spacing, m; measure it")
    marker: float = Field(0.0, ge=0.0, description="marker side, m (charuco); 0 = 0.72 square")
    dictionary: str = Field("DICT_5X5_100", description="ArUco dictionary (charuco)")
    legacy: bool = Field(False, description="charuco boards printed before OpenCV 4.6")

    @model_validator(mode="after")
    def _fits(self) -> Board:
        if self.marker >= self.square:
            raise ValueError(
                f"marker: expected less than the square's {self.square * 1e3:g} mm, got "
                f"{self.marker * 1e3:g} mm; markers stand inside squares"
            )
        return self

    @property
    def marker_side(self) -> float:
        """Side of a marker, metres."""
        return self.marker or 0.72 * self.square

    @property
    def shape(self) -> tuple[int, int]:
        """Columns and rows of points."""
        if self.kind == "charuco":
            return self.columns - 1, self.rows - 1
        return self.columns, self.rows

    @property
    def points(self) -> Float:
        """(P, 3) float64 metres in the board frame, row by row."""
        columns, rows = self.shape
        j, i = np.meshgrid(np.arange(columns, dtype=float), np.arange(rows, dtype=float))
        if self.kind == "charuco":
            x, y = j + 1.0, i + 1.0
        elif self.kind == "acircles":
            x, y = 2.0 * j + i % 2, i
        else:
            x, y = j, i
        return self.square * np.stack([x, y, np.zeros_like(x)], axis=-1).reshape(-1, 3)

    @property
    def turnable(self) -> bool:
        """The picture cannot tell the board from itself turned by 180 degrees."""
        if self.kind == "chessboard":
            return (self.columns + self.rows) % 2 == 0
        if self.kind == "acircles":
            return self.rows % 2 == 1
        return self.kind == "circles"

    @property
    def text(self) -> str:
        """One line for people, and the inverse of `parse_board`."""
        base = f"{self.kind}:{self.columns}x{self.rows}:{self.square * 1e3:g}mm"
        if self.kind == "charuco":
            base += f":{self.marker_side * 1e3:g}mm:{self.dictionary}"
            base += ":legacy" if self.legacy else ""
        return base


def half_turn(board: Board) -> Float:
    """(4, 4) transform of the board frame that maps the board's points onto themselves, turned."""
    T = np.diag([-1.0, -1.0, 1.0, 1.0])
    T[:3, 3] = board.points[0] + board.points[-1]
    return T


def parse_board(text: str) -> Board:
    """A board from a file or a line such as ``chessboard:9x6:25mm`` or ``charuco:10x7:25mm:18mm``.

    Raises:
        CalibrationError: neither a file nor such a line.
    """
    if text.endswith(".toml"):
        return read_board(Path(text))
    parts = text.split(":")
    try:
        kind, size, *rest = parts
        columns, rows = (int(n) for n in size.lower().split("x"))
        values: dict[str, object] = {"kind": kind, "columns": columns, "rows": rows}
        lengths = [_metres(p) for p in rest if not p.startswith(("DICT_", "legacy"))]
        values |= dict(zip(("square", "marker"), lengths, strict=False))
        for part in rest:
            if part.startswith("DICT_"):
                values["dictionary"] = part
        values["legacy"] = "legacy" in rest
        return Board.model_validate(values)
    except ValidationError as error:
        raise CalibrationError(f"board '{text}': {_problems(error)}") from error
    except ValueError as error:
        raise CalibrationError(
            f"board '{text}': expected a board file (*.toml) or a line such as "
            "chessboard:9x6:25mm (inner corners), charuco:10x7:25mm:18mm:DICT_5X5_100 (squares) "
            "or acircles:4x11:20mm"
        ) from error


def read_board(path: Path) -> Board:
    """The board of a ``*.board.toml`` or of a collected session's ``board.toml``.

    Raises:
        CalibrationError: missing or wrong.
    """
    try:
        values = tomllib.loads(path.read_text(encoding="utf-8"))
        return Board.model_validate(values)
    except FileNotFoundError as error:
        raise CalibrationError(
            f"{path}: expected a board file, found none; `clothrf calibrate board` writes one"
        ) from error
    except (OSError, UnicodeDecodeError, tomllib.TOMLDecodeError) as error:
        raise CalibrationError(f"{path}: expected TOML ({error})") from error
    except ValidationError as error:
        raise CalibrationError(f"{path}: {_problems(error)}") from error


def _metres(text: str) -> float:
    for suffix, factor in (("mm", 1e-3), ("cm", 1e-2), ("m", 1.0)):
        if text.endswith(suffix):
            return float(text.removesuffix(suffix)) * factor
    raise ValueError(f"a length needs a unit, got '{text}'")


def _problems(error: ValidationError) -> str:
    return "; ".join(
        f"{'.'.join(map(str, e['loc'])) or 'board'}: {e['msg']}" for e in error.errors()
    )
