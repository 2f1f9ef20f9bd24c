"""Turns what was typed into boards, poses, rigs and components; every mistake is one line."""

from __future__ import annotations

import tomllib
from pathlib import Path
from typing import Any

import numpy as np
from pydantic import ValidationError

from clothrf_calibration import rigid
from clothrf_calibration.boards import Board, parse_board, read_board
from clothrf_calibration.boardshape import SHAPES, Shape, deformed, shape_basis
from clothrf_calibration.camerafile import board_of_tables, read_intrinsics
from clothrf_calibration.errors import CalibrationError
from clothrf_calibration.images import find_images, read_counts
from clothrf_calibration.posefile import Poses, match, read_poses
from clothrf_calibration.terminal import warn
from clothrf_calibration.views import View, view_name
from clothrf_core.errors import ConfigError
from clothrf_core.provider import BuildContext
from clothrf_core.registry import Registry
from clothrf_core.rig import Rig
from clothrf_core.types import Float


def board_beside(text: str, folder: Path) -> Board:
    """The board of --board, or of the folder it was collected in."""
    if text:
        return parse_board(text)
    beside = (folder if folder.is_dir() else folder.parent) / "board.toml"
    if beside.exists():
        return read_board(beside)
    raise CalibrationError(
        f"expected --board (for example --board chessboard:9x6:25mm) or {beside}, found neither"
    )


def known_board(
    text: str, pictures: Path, tables: dict[str, Any], camera: Path
) -> tuple[Board, Float]:
    """The board of new pictures; its true shape if it is the one the camera file was made with."""
    if "board" in tables:
        made, shape, numbers = board_of_tables(tables, camera)
        beside = (pictures if pictures.is_dir() else pictures.parent) / "board.toml"
        other = parse_board(text) if text else read_board(beside) if beside.exists() else made
        if other.text == made.text:
            known: Shape = next((s for s in SHAPES if s == shape), "flat")
            return made, deformed(made, shape_basis(made, known), numbers)
        return other, other.points
    made = board_beside(text, pictures)
    return made, made.points


def with_missing(views: list[View], pictures: Path, found: Poses) -> list[View]:
    """A view for every picture that has a pose; empty where no board was found."""
    names = [view_name(p) for p in find_images(pictures)]
    known = {v.name: v for v in views}
    empty = View("", views[0].size, np.zeros(0, np.int64), np.zeros((0, 2)))
    wanted = names if not found.names else [n for n in names if n in set(found.names)] or names
    return [known.get(n, View(n, empty.size, empty.ids, empty.pixels)) for n in wanted]


def poses_of_pictures(found: Poses, pictures: Path) -> Float:
    """(V, 4, 4) poses of the pictures that have one."""
    names = [view_name(p) for p in find_images(pictures)]
    if found.names:
        here = [n for n in names if n in set(found.names)]
        missing = [n for n in names if n not in set(found.names)]
        for name in missing:
            warn(f"{name} has no pose and is left out")
        names = here or names
    return match(found, names)


def predicted_boards(
    file: Path, views: list[View], tables: dict[str, Any]
) -> dict[str, Float] | None:
    """View -> (4, 4) T_camera_board that the robot says, if the file can tell."""
    e = tables.get("extrinsics", {})
    found = read_poses(file)
    if not found.names or "setup" not in e:
        return None
    rows = dict(zip(found.names, found.T_base_gripper, strict=True))
    if e["setup"] == "fixed":
        X, Z = np.array(e["T_base_camera"], float), np.array(e["T_gripper_board"], float)
        return {v.name: rigid.inverse(X) @ rows[v.name] @ Z for v in views if v.name in rows}
    X, Z = np.array(e["T_gripper_camera"], float), np.array(e["T_base_board"], float)
    return {
        v.name: rigid.inverse(X) @ rigid.inverse(rows[v.name]) @ Z for v in views if v.name in rows
    }


def refuse_other_size(views: list[View], tables: dict[str, Any]) -> None:
    """Raises where pictures are not of the size in the camera file."""
    wanted = (tables["camera"]["width"], tables["camera"]["height"])
    if views[0].size != wanted:
        raise CalibrationError(
            f"expected pictures of {wanted[0]} x {wanted[1]} as the camera file says, found "
            f"{views[0].size[0]} x {views[0].size[1]}; intrinsics hold for one resolution only"
        )


def parse_place(text: str) -> Float:
    """(4, 4) of ``x,y,z,rx,ry,rz``."""
    try:
        numbers = np.array([float(n) for n in text.split(",")])
    except ValueError as error:
        raise CalibrationError(f"--place: expected x,y,z,rx,ry,rz, got '{text}'") from error
    if numbers.size != 6:
        raise CalibrationError(f"--place: expected six numbers x,y,z,rx,ry,rz, got {numbers.size}")
    if np.linalg.norm(numbers[:3]) > 10 or np.abs(numbers[3:]).max() > 2.05 * np.pi:
        raise CalibrationError(
            f"--place: expected metres and radians, got {text}; that looks like millimetres or "
            "degrees"
        )
    T = np.eye(4)
    T[:3, :3], T[:3, 3] = rigid.exp(numbers[3:]), numbers[:3]
    return T


def read_rig(path: Path | None) -> Rig | None:
    """The rig in a file, its camera perhaps in another."""
    if path is None:
        return None
    try:
        tree = tomllib.loads(path.read_text(encoding="utf-8"))
        if isinstance(tree.get("camera"), dict) and "file" in tree["camera"]:
            file = path.parent / str(tree["camera"].pop("file"))
            tree["camera"] = {**read_intrinsics(file)[0].model_dump(), **tree["camera"]}
        return Rig.model_validate(tree)
    except FileNotFoundError as error:
        raise ConfigError(f"{path}: expected a rig file, found none") from error
    except (OSError, UnicodeDecodeError, tomllib.TOMLDecodeError) as error:
        raise ConfigError(f"{path}: expected TOML ({error})") from error
    except ValidationError as error:
        first = error.errors()[0]
        where = ".".join(map(str, first["loc"]))
        raise ConfigError(f"{path}: {where}: {first['msg']}") from error


def rig_camera(rig: Rig | None) -> Any:
    """The camera of a rig that must be given."""
    if rig is None:
        raise CalibrationError("a rendered camera needs --rig, which says where it stands")
    return rig.camera.model()


def build_component(
    registry: Registry, kind: str, name: str, options: list[str] | None, context: BuildContext
) -> Any:
    """A camera or robot with options given as key=value."""
    config = registry.find(kind, name).config
    values: dict[str, Any] = {}
    for text in options or []:
        key, _, value = text.partition("=")
        try:
            values[key] = tomllib.loads(f"v = {value}")["v"]
        except tomllib.TOMLDecodeError:
            values[key] = value
    if kind == "camera" and name == "folder":
        values = {"depth": "optional", "guess_intrinsics": True, **values}
    try:
        return registry.build(kind, name, config.model_validate(values), context)
    except ValidationError as error:
        first = error.errors()[0]
        raise ConfigError(
            f"{kind} '{name}': {'.'.join(map(str, first['loc']))}: {first['msg']}; pass it with "
            "--set key=value"
        ) from error


def depth_unit_of(path: Path) -> float:
    """Metres a count of the depth pictures beside a camera file."""
    if path.suffix != ".toml" or not path.exists():
        return 0.001
    return float(read_intrinsics(path)[0].depth_unit)


def read_metres(path: Path, unit: float) -> Any:
    """(H, W) float32 depth, NaN where not measured."""
    counts = read_counts(path)
    depth = counts.astype(np.float32) * np.float32(unit)
    depth[counts == 0] = np.nan
    return depth
