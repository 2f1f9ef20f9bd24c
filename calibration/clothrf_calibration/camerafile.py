"""Writes the ``*.camera.toml``: the numbers that a rig needs, and all that is known about them.

Tables besides ``[camera]`` (which `clothrf_core.camera_file` reads)::

    [provenance]   command, date, versions, detector, pictures, board, size
    [board]        the board as drawn, and `shape` with its `shape_numbers` as solved for
    [residuals]    rms_px, sigma_px, corners, rejected, correlation_factor, held_out_px,
                   held_out_spread_px, [residuals.views]
    [uncertainty]  names, sd, covariance, projection_mean_px, projection_worst_px
    [tried]        held-out error of every lens model and board shape, pixels
    [extrinsics]   setup, method, T_.._.. matrices, covariance, sd, held-out errors, scale
    [warnings]     lines
"""

from __future__ import annotations

import importlib.metadata
from collections.abc import Mapping, Sequence
from datetime import UTC, datetime
from pathlib import Path
from typing import Any

import cv2
import numpy as np
import tomli_w

from clothrf_calibration.boards import Board
from clothrf_calibration.detect import DETECTOR
from clothrf_calibration.errors import CalibrationError
from clothrf_calibration.handeye import HandEye
from clothrf_calibration.intrinsics import Calibration, correlation
from clothrf_calibration.lens import matrix, vector
from clothrf_calibration.uncertainty import stated_uncertainty, uncertainty_warnings
from clothrf_calibration.views import View
from clothrf_core.camera_file import VERSION, read_camera_file, read_camera_tables
from clothrf_core.files import atomic_write
from clothrf_core.rig import CameraSection
from clothrf_core.types import Float

NAMES = ("fx", "fy", "cx", "cy", "k1", "k2", "p1", "p2", "k3", "k4", "k5", "k6")
Tables = dict[str, Any]


def intrinsics_tables(
    c: Calibration, *, command: str, pictures: str, depth_unit: float = 0.001, near: float = 0.1,
    far: float = 2.0,
) -> Tables:  # fmt: skip
    """All tables of a file that knows the intrinsics; the pose is the identity."""
    width, height = c.fit.views[0].size
    p = c.parameters
    camera = {
        "width": width,
        "height": height,
        "K": matrix(p).tolist(),
        "distortion": p[4:].tolist(),
        "T_world_camera": np.eye(4).tolist(),
        "near": near,
        "far": far,
        "depth_unit": depth_unit,
        "provenance": f"{int(c.used.sum())} pictures of {c.board.text}, RMS {c.fit.rms:.3f} px",
    }
    held = c.held_out
    residuals: Tables = {
        "rms_px": c.fit.rms,
        "sigma_px": c.fit.sigma,
        "corners": int(sum(len(v.ids) for v in c.fit.views)),
        "rejected": c.fit.rejected,
        "correlation_factor": correlation(c.fit),
    }
    if held is not None:
        residuals |= {"held_out_px": held.total, "held_out_spread_px": held.spread}
    residuals["views"] = [
        {"name": v.name, "rms_px": _rms(r, m), "corners": len(v.ids), "rejected": int((~m).sum())}
        for v, r, m in zip(c.fit.views, c.fit.residuals, c.fit.inliers, strict=True)
    ]
    return {
        "kind": "camera",
        "version": VERSION,
        "camera": camera,
        "provenance": provenance(command, pictures=pictures) | {"board": c.board.text},
        "board": c.board.model_dump()
        | {"shape": c.fit.board_shape, "shape_numbers": c.fit.state.shape.tolist()},
        "residuals": residuals,
        "uncertainty": {
            "names": list(NAMES[: p.size]),
            "sd": np.sqrt(np.diag(c.covariance)).tolist(),
            "covariance": c.covariance.tolist(),
            "projection_mean_px": c.uncertainty.mean,
            "projection_worst_px": c.uncertainty.worst,
            "projection_near_mean_px": c.near_uncertainty.mean,
        },
        "tried": {
            "models_px": {f"k{m}": e for m, e in c.models.items()},
            "board_shapes_px": dict(c.shapes),
        },
        "dropped": dict(c.dropped),
        "warnings": {
            "intrinsics": [w for w in c.warnings if w not in c.uncertain],
            "uncertainty": c.uncertain,
        },
    }


def with_extrinsics(
    tables: Mapping[str, Any],
    h: HandEye,
    *,
    command: str,
    pictures: str,
    points: Float,
    views: Sequence[View],
) -> Tables:
    """The tables with a hand-eye result; a standing camera's pose goes into ``[camera]``.

    `points` and `views` are the board and the pictures of it that were used.
    """
    outer, inner = (
        ("T_base_camera", "T_gripper_board")
        if h.setup == "fixed"
        else ("T_gripper_camera", "T_base_board")
    )
    result: Tables = _copied(tables)
    result["extrinsics"] = {
        **provenance(command, pictures=pictures),
        "method": f"joint reprojection refinement from {h.start}",
        "setup": h.setup,
        outer: h.X.tolist(),
        inner: h.Z.tolist(),
        "covariance": h.covariance.tolist(),
        "sd_mm": h.sd_mm,
        "sd_deg": h.sd_deg,
        "views": len(h.names),
        "rms_px": float(np.sqrt((h.rms**2).mean())),
        "corner_sigma_px": h.sigma,
        "held_out_px": _rms1(h.held_out_px),
        "held_out_mm": _rms1(h.held_out_mm),
        "held_out_deg": _rms1(h.held_out_deg),
        "held_out_spread_mm": float(np.std(h.held_out_mm)),
        "board_scale": h.scale[0],
        "board_scale_sd": h.scale[1],
        "robot_turn_sd_deg": float(np.degrees(h.noise.turn)),
        "robot_shift_sd_mm": 1e3 * h.noise.shift,
        "dropped": dict(h.dropped),
        "starts_px": dict(h.starts),
    }
    if h.setup == "fixed":
        result["camera"]["T_world_camera"] = h.X.tolist()
    if h.intrinsics_covariance is not None:
        # The pose goes with the intrinsics that were refined together with it.
        result["camera"]["K"] = matrix(h.intrinsics).tolist()
        result["camera"]["distortion"] = h.intrinsics[4:].tolist()
        C = h.intrinsics_covariance
        result["uncertainty"].pop("projection_near_mean_px", None)  # of the lens as it was
        projections = stated_uncertainty(h.intrinsics, C, points, views)
        result["uncertainty"] |= {
            "sd": np.sqrt(np.diag(C)).tolist(),
            "covariance": C.tolist(),
            "projection_mean_px": projections.mean,
            "projection_worst_px": projections.worst,
        }
        left = uncertainty_warnings(h.intrinsics, C, projections)
        result.setdefault("warnings", {})["uncertainty"] = left
    result.setdefault("warnings", {})["extrinsics"] = list(h.warnings)
    return result


def provenance(command: str, *, pictures: str) -> Tables:
    """Who made this, when, with what."""
    return {
        "command": command,
        "date": datetime.now(UTC).isoformat(timespec="seconds"),
        "clothrf": importlib.metadata.version("clothrf"),
        "opencv": cv2.__version__,
        "numpy": np.__version__,
        "detector": DETECTOR,
        "pictures": pictures,
    }


def write_tables(path: Path, tables: Mapping[str, Any], *, replace: bool = False) -> None:
    """Write a camera file that reads back; an existing one is kept unless `replace`.

    Raises:
        CalibrationError: a file of that name exists.
    """
    if path.exists() and not replace:
        raise CalibrationError(
            f"{path}: expected no file of that name, found one; choose another --out or say "
            "--replace"
        )
    CameraSection.model_validate(tables["camera"]).model()
    path.parent.mkdir(parents=True, exist_ok=True)
    atomic_write(path, tomli_w.dumps(tables).encode())


def read_intrinsics(path: Path) -> tuple[CameraSection, Float, Float | None, Tables]:
    """Camera, intrinsic vector, its covariance if the file has one, and all tables."""
    section = read_camera_file(path)
    tables = read_camera_tables(path)
    parameters = vector(np.array(section.K, float), np.array(section.distortion, float))
    found = tables.get("uncertainty", {}).get("covariance")
    covariance = None if found is None else np.array(found, float)
    if covariance is not None and covariance.shape != (parameters.size, parameters.size):
        covariance = None
    return section, parameters, covariance, tables


def board_of_tables(tables: Mapping[str, Any], path: Path) -> tuple[Board, str, Float]:
    """The board a camera file was made with, its shape and the shape's numbers.

    Raises:
        CalibrationError: the file does not say.
    """
    if "board" not in tables:
        raise CalibrationError(f"{path}: expected a table [board], found none; pass --board")
    values = dict(tables["board"])
    shape = str(values.pop("shape", "flat"))
    numbers = np.array(values.pop("shape_numbers", []), float)
    return Board.model_validate(values), shape, numbers


def _rms(residual: Float, mask: Any) -> float:
    kept = residual[mask] if mask.any() else residual
    return float(np.sqrt((kept**2).sum(axis=1).mean()))


def _rms1(values: Float) -> float:
    return float(np.sqrt((np.asarray(values) ** 2).mean()))


def _copied(value: Any) -> Any:
    if isinstance(value, Mapping):
        return {k: _copied(v) for k, v in value.items()}
    if isinstance(value, Sequence) and not isinstance(value, str):
        return [_copied(v) for v in value]
    return value
