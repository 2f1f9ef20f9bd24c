"""The files of a picture folder: which there are, when they were taken, what they hold.

::

    0001_color.png      8-bit colour (png, jpg, jpeg, bmp)
    0001_depth.png      16-bit depth; 0 = not measured; metres = count * camera.depth_unit
    camera.toml         intrinsics, pose and depth_unit (`clothrf_core.camera_file`)
    stamps.csv          optional: name,stamp_ns   (name = what stands before _color)

Without `stamps.csv`, names that are whole numbers of 16 to 19 digits are nanoseconds and decimal
names such as 12.345 are seconds; otherwise pictures follow each other at the configured rate.
"""

from __future__ import annotations

import csv
import itertools
import re
from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path

import cv2
import numpy as np
from numpy.typing import NDArray

from clothrf_core.errors import DataError
from clothrf_core.types import Float32

SUFFIXES = (".png", ".jpg", ".jpeg", ".bmp")


@dataclass(frozen=True, slots=True)
class PictureFiles:
    """One picture of a folder.

    Attributes:
        name: what stands before ``_color``.
        color: its colour file.
        depth: its depth file, None if there is none.
        stamp_ns: time of exposure, nanoseconds; None if the folder does not say.
    """

    name: str
    color: Path
    depth: Path | None
    stamp_ns: int | None


def list_pictures(folder: Path, *, depth_required: bool) -> list[PictureFiles]:
    """All pictures of `folder` in the order of their stamps, else of their names.

    Raises:
        DataError: no folder, no pictures, depth missing, or stamps that do not fit.
    """
    if not folder.is_dir():
        raise DataError(f"{folder}: expected a folder of pictures, found none")
    images = sorted(p for p in folder.iterdir() if p.suffix.lower() in SUFFIXES)
    colors = [p for p in images if p.stem.endswith("_color")]
    if not colors and not depth_required:
        colors = [p for p in images if not p.stem.endswith("_depth")]
    if not colors:
        raise DataError(
            f"{folder}: expected pictures named *_color.png with *_depth.png beside them, found "
            f"{len(images)} other pictures"
        )
    stamps = _stamps(folder, [_name(p) for p in colors])
    files = []
    for color, stamp in zip(colors, stamps, strict=True):
        depth = folder / f"{_name(color)}_depth.png"
        if not depth.exists() and depth_required:
            raise DataError(
                f"{color}: expected {depth.name} beside it, found none; add it or set "
                'depth = "optional"'
            )
        files.append(PictureFiles(_name(color), color, depth if depth.exists() else None, stamp))
    if all(f.stamp_ns is not None for f in files):
        files.sort(key=lambda f: f.stamp_ns or 0)
        times = [f.stamp_ns or 0 for f in files]
        if any(b <= a for a, b in itertools.pairwise(times)):
            raise DataError(f"{folder}: expected one stamp a picture, found the same stamp twice")
    else:
        files.sort(key=lambda f: [int(t) if t.isdigit() else t for t in re.split(r"(\d+)", f.name)])
    return files


def read_color(path: Path) -> NDArray[np.uint8]:
    """(H, W, 3) uint8 RGB.

    Raises:
        DataError: truncated or not a picture.
    """
    image = cv2.imdecode(buf=_bytes(path), flags=cv2.IMREAD_COLOR)
    if image is None:
        raise DataError(f"{path}: expected a picture, found a truncated or foreign file; delete it")
    return cv2.cvtColor(src=image, code=cv2.COLOR_BGR2RGB).astype(np.uint8, copy=False)


def read_depth(path: Path, *, unit: float) -> Float32:
    """(H, W) float32 metres; NaN where the file holds 0. `unit` is metres a count.

    Raises:
        DataError: truncated or not a 16-bit picture.
    """
    image = cv2.imdecode(buf=_bytes(path), flags=cv2.IMREAD_UNCHANGED)
    if image is None:
        raise DataError(f"{path}: expected a picture, found a truncated or foreign file; delete it")
    if image.dtype != np.uint16 or image.ndim != 2:
        raise DataError(
            f"{path}: expected one channel of 16 bits, found {image.dtype} of shape {image.shape}; "
            "save depth as 16-bit PNG"
        )
    depth = image.astype(np.float32) * np.float32(unit)
    depth[image == 0] = np.nan
    return depth


def _bytes(path: Path) -> NDArray[np.uint8]:
    try:
        data = path.read_bytes()
    except OSError as error:
        raise DataError(f"{path}: expected a readable picture ({error})") from error
    png_cut = data[:4] == b"\x89PNG" and b"IEND" not in data[-16:]
    jpg_cut = data[:2] == b"\xff\xd8" and b"\xff\xd9" not in data[-64:]
    if not data or png_cut or jpg_cut:
        raise DataError(f"{path}: expected a whole picture, found a truncated file; delete it")
    return np.frombuffer(data, np.uint8)


def _name(color: Path) -> str:
    return color.stem.removesuffix("_color")


def _stamps(folder: Path, names: Sequence[str]) -> list[int | None]:
    table = folder / "stamps.csv"
    if table.exists():
        with table.open(newline="", encoding="utf-8") as file:
            rows = list(csv.DictReader(file))
        try:
            known = {row["name"]: int(row["stamp_ns"]) for row in rows}
        except (KeyError, TypeError, ValueError) as error:
            raise DataError(
                f"{table}: expected the columns name,stamp_ns with whole nanoseconds ({error})"
            ) from error
        missing = [name for name in names if name not in known]
        if missing:
            raise DataError(
                f"{table}: expected a stamp for every picture, found none for {missing[0]}"
            )
        return [known[name] for name in names]
    if all(re.fullmatch(r"\d{16,19}", name) for name in names):
        return [int(name) for name in names]
    if all(re.fullmatch(r"\d+\.\d+", name) for name in names):
        return [_nanoseconds(name) for name in names]
    return [None for _ in names]


def _nanoseconds(seconds: str) -> int:
    whole, _, part = seconds.partition(".")
    return int(whole) * 1_000_000_000 + int(part[:9].ljust(9, "0"))
