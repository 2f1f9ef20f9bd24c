"""Reads the camera out of a ``*.camera.toml``, the file that calibration writes.

The file::

    kind = "camera"
    version = 1
    [camera]        # the fields of `CameraSection`: what a rig needs
    [provenance]    # who, when, with which board and which pictures
    [residuals]     # fit and held-out reprojection errors, pixels
    [uncertainty]   # standard deviations and covariance of the numbers in [camera]

Only ``[camera]`` is read here; the other tables are for people and for the calibration tools.
"""

from __future__ import annotations

import tomllib
from collections.abc import Mapping
from pathlib import Path
from typing import Any

from pydantic import ValidationError

from clothrf_core.errors import ConfigError, ShapeError, suggestion
from clothrf_core.rig import CameraSection

VERSION = 1


def read_camera_file(path: Path) -> CameraSection:
    """The camera of a ``*.camera.toml`` (or of any file with a ``[camera]`` table, as a rig has).

    Raises:
        ConfigError: missing, not TOML, of a later version, or with wrong numbers; the message
            lists every problem.
    """
    tables = read_camera_tables(path)
    section = tables.get("camera")
    if not isinstance(section, Mapping):
        raise ConfigError(
            f"{path}: expected a table [camera] with width, height, K and T_world_camera, found "
            f"{', '.join(f'[{name}]' for name in tables) or 'an empty file'}"
        )
    try:
        camera = CameraSection.model_validate(dict(section))
        camera.model()
    except ValidationError as error:
        problems = "; ".join(_problem(e) for e in error.errors())
        raise ConfigError(f"{path}: {problems}") from error
    except (ShapeError, ValueError) as error:
        raise ConfigError(f"{path}: {error}") from error
    return camera


def read_camera_tables(path: Path) -> dict[str, Any]:
    """All tables of a camera file, unchecked but for kind and version.

    Raises:
        ConfigError: missing, not TOML, or of a later version.
    """
    try:
        tables = tomllib.loads(path.read_text(encoding="utf-8"))
    except FileNotFoundError as error:
        raise ConfigError(
            f"{path}: expected a camera file, found none; `clothrf calibrate` writes one"
        ) from error
    except (OSError, UnicodeDecodeError, tomllib.TOMLDecodeError) as error:
        raise ConfigError(f"{path}: expected TOML, found something else ({error})") from error
    version = tables.get("version", VERSION)
    if not isinstance(version, int) or version > VERSION:
        raise ConfigError(
            f"{path}: expected a camera file of version {VERSION} or less, found {version}; "
            "update clothrf"
        )
    return tables


def _problem(error: Any) -> str:
    where = ".".join(str(part) for part in error["loc"])
    if error["type"] == "extra_forbidden":
        hint = suggestion(str(error["loc"][-1]), CameraSection.model_fields)
        return f"camera.{where}: unknown key. {hint}"
    return f"camera.{where}: {error['msg']}"
