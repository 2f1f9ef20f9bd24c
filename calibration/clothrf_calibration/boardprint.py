"""Printable boards: a PDF of vectors and a PNG, at true scale, with a ruler to check the print."""

from __future__ import annotations

import zlib
from pathlib import Path

import cv2
import numpy as np
import tomli_w
from numpy.typing import NDArray

from clothrf_calibration.boarddrawing import Drawing, drawing
from clothrf_calibration.boards import Board
from clothrf_calibration.errors import CalibrationError
from clothrf_core.errors import suggestion
from clothrf_core.files import atomic_write
from clothrf_core.types import Float

PAPERS = {
    "A4": (0.297, 0.210),
    "A3": (0.420, 0.297),
    "A2": (0.594, 0.420),
    "A1": (0.841, 0.594),
    "A0": (1.189, 0.841),
    "letter": (0.2794, 0.2159),
}
MARGIN, FOOT, RULER = 0.010, 0.009, 0.100
POINTS_PER_M = 72.0 / 0.0254


def write_board(board: Board, folder: Path, *, paper: str = "A4", dpi: int = 300) -> list[Path]:
    """Write PDF, PNG and ``*.board.toml`` into `folder`; an existing board file is kept.

    Raises:
        CalibrationError: the board does not fit the paper.
    """
    name = board.text.replace(":", "_")
    pdf, png = pdf_page(board, paper), png_page(board, paper, dpi=dpi)
    folder.mkdir(parents=True, exist_ok=True)
    paths = [
        folder / f"{name}_{paper}.pdf",
        folder / f"{name}_{paper}.png",
        folder / f"{name}.board.toml",
    ]
    atomic_write(paths[0], pdf)
    atomic_write(paths[1], png)
    if not paths[2].exists():
        atomic_write(paths[2], board_toml(board).encode())
    return paths


def board_toml(board: Board) -> str:
    """The board file; `square` is to be replaced by what a ruler says about the print."""
    text = "# Measure the print over many squares and correct `square` (and `marker`), metres.\n"
    values = board.model_dump() | {"marker": board.marker_side}
    if board.kind != "charuco":
        for key in ("marker", "dictionary", "legacy"):
            values.pop(key)
    return text + tomli_w.dumps(values)


def board_picture(board: Board, width: int) -> tuple[NDArray[np.uint8], float, Float]:
    """The board with a white margin, `width` pixels wide.

    Returns:
        (h, width) uint8, pixels a metre, and (2,) o with ``x_board = pixel / scale - o``.
    """
    drawn = drawing(board)
    low, high = drawn.low - board.square, drawn.high + board.square
    scale = width / float(high[0] - low[0])
    rows = round(scale * float(high[1] - low[1]))
    dark = _rasterised(drawn, scale, -low, (rows, width))
    return np.asarray(np.round(255.0 * (1.0 - dark)), np.uint8), scale, -low - 0.5 / scale


def pdf_page(board: Board, paper: str = "A4") -> bytes:
    """One page of vectors.

    Raises:
        CalibrationError: the board does not fit the paper, or no such paper.
    """
    drawn = drawing(board)
    width, height, offset = _layout(board, drawn, paper)

    def at(x: float, y: float) -> tuple[float, float]:
        return x * POINTS_PER_M, (height - y) * POINTS_PER_M

    parts = ["0 g"]
    for x0, y0, x1, y1 in drawn.rectangles + np.tile(offset, 2):
        x, y = at(x0, y1)
        parts.append(f"{x:.3f} {y:.3f} {(x1 - x0) * POINTS_PER_M:.3f} "
                     f"{(y1 - y0) * POINTS_PER_M:.3f} re")  # fmt: skip
    for x, y, r in drawn.discs + np.append(offset, 0.0):
        parts.append(_pdf_disc(*at(x, y), r * POINTS_PER_M))
    parts.append("f")
    parts += _pdf_ruler(board, width, height)
    return _pdf(width, height, "\n".join(parts))


def png_page(board: Board, paper: str = "A4", *, dpi: int = 300) -> bytes:
    """The same page as a grey PNG that carries its resolution."""
    drawn = drawing(board)
    width, height, offset = _layout(board, drawn, paper)
    scale = dpi / 0.0254
    shape = (round(height * scale), round(width * scale))
    page = np.asarray(np.round(255.0 * (1.0 - _rasterised(drawn, scale, offset, shape))), np.uint8)
    y = height - MARGIN
    for n in range(101):
        x = round((MARGIN + n * 1e-3) * scale)
        length = 0.005 if n % 10 == 0 else 0.003 if n % 5 == 0 else 0.002
        page[round((y - length) * scale) : round(y * scale), x : x + max(dpi // 150, 1)] = 0
    cv2.putText(
        img=page,
        text=_caption(board),
        org=(round((MARGIN + RULER + 0.006) * scale), round(y * scale)),
        fontFace=cv2.FONT_HERSHEY_SIMPLEX,
        fontScale=dpi / 300,
        color=0,
        thickness=max(dpi // 150, 1),
        lineType=cv2.LINE_AA,
    )
    _, encoded = cv2.imencode(ext=".png", img=page)
    data = encoded.tobytes()
    per_m = round(scale).to_bytes(4, "big")
    chunk = b"pHYs" + per_m + per_m + b"\x01"
    chunk = (9).to_bytes(4, "big") + chunk + zlib.crc32(chunk).to_bytes(4, "big")
    return data[:33] + chunk + data[33:]


def _layout(board: Board, drawn: Drawing, paper: str) -> tuple[float, float, Float]:
    """Page width and height, and the shift from the board frame to the page, metres."""
    if paper not in PAPERS:
        raise CalibrationError(f"no paper called '{paper}'. {suggestion(paper, PAPERS)}")
    size = drawn.high - drawn.low
    for width, height in (PAPERS[paper], PAPERS[paper][::-1]):
        room = np.array([width - 2 * MARGIN, height - 2 * MARGIN - FOOT])
        if (size <= room + 1e-9).all():
            return width, height, MARGIN + 0.5 * (room - size) - drawn.low
    room = np.array(PAPERS[paper]) - [2 * MARGIN, 2 * MARGIN + FOOT]
    raise CalibrationError(
        f"board {board.text}: expected at most {room[0] * 1e3:.0f} x {room[1] * 1e3:.0f} mm on "
        f"{paper}, found {size[0] * 1e3:.0f} x {size[1] * 1e3:.0f} mm; take smaller squares or "
        "--paper A3"
    )


def _rasterised(drawn: Drawing, scale: float, offset: Float, shape: tuple[int, int]) -> Float:
    """(h, w) share of every pixel's area that is black; pixel i covers [i, i + 1] / scale."""
    dark = np.zeros(shape)
    for x0, y0, x1, y1 in scale * (drawn.rectangles + np.tile(offset, 2)):
        rows, cover_y = _cover(y0, y1, shape[0])
        columns, cover_x = _cover(x0, x1, shape[1])
        dark[rows, columns] += cover_y[:, None] * cover_x
    for x, y, r in scale * (drawn.discs + np.append(offset, 0.0)):
        rows = slice(max(int(y - r) - 1, 0), int(y + r) + 3)
        columns = slice(max(int(x - r) - 1, 0), int(x + r) + 3)
        v = np.arange(rows.start, min(rows.stop, shape[0])) + 0.5 - y
        u = np.arange(columns.start, min(columns.stop, shape[1])) + 0.5 - x
        dark[rows, columns] += np.clip(r - np.hypot(u, v[:, None]) + 0.5, 0.0, 1.0)
    return np.minimum(dark, 1.0)


def _cover(low: float, high: float, count: int) -> tuple[slice, Float]:
    first, last = max(int(np.floor(low)), 0), min(int(np.ceil(high)), count)
    n = np.arange(first, last)
    return slice(first, last), np.minimum(n + 1, high) - np.maximum(n, low)


def _pdf_disc(x: float, y: float, r: float) -> str:
    k = 0.5522847498 * r
    return (
        f"{x + r:.3f} {y:.3f} m "
        f"{x + r:.3f} {y + k:.3f} {x + k:.3f} {y + r:.3f} {x:.3f} {y + r:.3f} c "
        f"{x - k:.3f} {y + r:.3f} {x - r:.3f} {y + k:.3f} {x - r:.3f} {y:.3f} c "
        f"{x - r:.3f} {y - k:.3f} {x - k:.3f} {y - r:.3f} {x:.3f} {y - r:.3f} c "
        f"{x + k:.3f} {y - r:.3f} {x + r:.3f} {y - k:.3f} {x + r:.3f} {y:.3f} c h"
    )


def _pdf_ruler(board: Board, width: float, height: float) -> list[str]:
    parts = ["0.4 w"]
    bottom = MARGIN * POINTS_PER_M
    for n in range(101):
        x = (MARGIN + n * 1e-3) * POINTS_PER_M
        length = (0.005 if n % 10 == 0 else 0.003 if n % 5 == 0 else 0.002) * POINTS_PER_M
        parts.append(f"{x:.3f} {bottom:.3f} m {x:.3f} {bottom + length:.3f} l S")
    x = (MARGIN + RULER + 0.006) * POINTS_PER_M
    text = _caption(board).replace("(", "\\(").replace(")", "\\)")
    parts.append(f"BT /F1 8 Tf {x:.3f} {bottom:.3f} Td ({text}) Tj ET")
    return parts


def _caption(board: Board) -> str:
    return f"{board.text}   Print at 100 %: this ruler must measure 100 mm. Glue to a stiff plate."


def _pdf(width: float, height: float, content: str) -> bytes:
    """A PDF file of one page (PDF 1.4, ISO 32000), content uncompressed so that it can be read."""
    box = f"[0 0 {width * POINTS_PER_M:.3f} {height * POINTS_PER_M:.3f}]"
    stream = content.encode("latin-1")
    objects = [
        b"<< /Type /Catalog /Pages 2 0 R /ViewerPreferences << /PrintScaling /None >> >>",
        b"<< /Type /Pages /Kids [3 0 R] /Count 1 >>",
        f"<< /Type /Page /Parent 2 0 R /MediaBox {box} /Contents 4 0 R "
        "/Resources << /Font << /F1 5 0 R >> >> >>".encode(),
        f"<< /Length {len(stream)} >>\nstream\n".encode() + stream + b"\nendstream",
        b"<< /Type /Font /Subtype /Type1 /BaseFont /Helvetica >>",
    ]
    data, places = b"%PDF-1.4\n", []
    for number, body in enumerate(objects, 1):
        places.append(len(data))
        data += f"{number} 0 obj\n".encode() + body + b"\nendobj\n"
    table = len(data)
    data += f"xref\n0 {len(objects) + 1}\n0000000000 65535 f \n".encode()
    data += b"".join(f"{place:010d} 00000 n \n".encode() for place in places)
    data += f"trailer\n<< /Size {len(objects) + 1} /Root 1 0 R >>\nstartxref\n{table}\n".encode()
    return data + b"%%EOF\n"
