"""Reads and writes pictures; a truncated file is an error, never a grey half."""

from __future__ import annotations

import re
from pathlib import Path
from typing import Any

import cv2
import numpy as np
from numpy.typing import NDArray

from clothrf_calibration.errors import CalibrationError
from clothrf_core.errors import DataError
from clothrf_core.files import atomic_write

SUFFIXES = (".png", ".jpg", ".jpeg", ".bmp", ".tif", ".tiff", ".pgm")


def find_images(folder: Path) -> list[Path]:
    """Colour or grey pictures of a folder (or one file) in natural order; depth left out.

    Raises:
        CalibrationError: there is none.
    """
    if folder.is_file():
        return [folder]
    if not folder.is_dir():
        raise CalibrationError(f"{folder}: expected a folder of pictures, found none")
    paths = [
        p
        for p in folder.iterdir()
        if p.suffix.lower() in SUFFIXES and not p.stem.endswith("_depth") and p.name[0] != "."
    ]
    if not paths:
        raise CalibrationError(
            f"{folder}: expected pictures ({' '.join(SUFFIXES)}), found none; take some with "
            "`clothrf calibrate collect`"
        )
    return sorted(paths, key=_natural)


def read_grey(path: Path) -> NDArray[np.uint8]:
    """(H, W) uint8.

    Raises:
        DataError: truncated or not a picture.
    """
    return np.asarray(_decode(path, cv2.IMREAD_GRAYSCALE), np.uint8)


def read_rgb(path: Path) -> NDArray[np.uint8]:
    """(H, W, 3) uint8.

    Raises:
        DataError: truncated or not a picture.
    """
    return np.asarray(
        cv2.cvtColor(src=_decode(path, cv2.IMREAD_COLOR), code=cv2.COLOR_BGR2RGB), np.uint8
    )


def read_counts(path: Path) -> NDArray[np.uint16]:
    """(H, W) uint16 of a depth picture.

    Raises:
        DataError: truncated or not a 16-bit picture.
    """
    image = _decode(path, cv2.IMREAD_UNCHANGED)
    if image.dtype != np.uint16 or image.ndim != 2:
        raise DataError(f"{path}: expected a 16-bit depth picture, found {image.dtype}")
    return np.asarray(image, np.uint16)


def write_png(path: Path, image: NDArray[np.uint8] | NDArray[np.uint16]) -> None:
    """Write grey, RGB or 16-bit pictures so that no half file can be left."""
    if image.ndim == 3:
        image = np.asarray(cv2.cvtColor(src=image, code=cv2.COLOR_RGB2BGR), np.uint8)
    _, data = cv2.imencode(ext=".png", img=image, params=[cv2.IMWRITE_PNG_COMPRESSION, 3])
    atomic_write(path, data.tobytes())


def _decode(path: Path, flags: int) -> NDArray[Any]:
    try:
        data = path.read_bytes()
    except OSError as error:
        raise DataError(f"{path}: expected a readable picture ({error})") from error
    png_cut = data[:4] == b"\x89PNG" and b"IEND" not in data[-16:]
    jpg_cut = data[:2] == b"\xff\xd8" and b"\xff\xd9" not in data[-64:]
    image = None
    if data and not png_cut and not jpg_cut:
        image = cv2.imdecode(buf=np.frombuffer(data, np.uint8), flags=flags)
    if image is None:
        raise DataError(f"{path}: expected a whole picture, found a truncated file; delete it")
    return np.asarray(image)


def _natural(path: Path) -> list[tuple[int, str]]:
    parts = re.split(r"(\d+)", path.name)
    return [(int(p), "") if p.isdigit() else (-1, p) for p in parts]
