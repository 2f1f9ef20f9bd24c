"""The longer actions behind the sub-commands."""

from __future__ import annotations

from pathlib import Path
from typing import Any

import numpy as np
from rich.table import Table

from clothrf_calibration import rigid
from clothrf_calibration.boardpose import fit_pose
from clothrf_calibration.boards import Board
from clothrf_calibration.camerafile import (
    board_of_tables,
    provenance,
    read_intrinsics,
)
from clothrf_calibration.errors import CalibrationError
from clothrf_calibration.handeye_points import fit_points
from clothrf_calibration.handeye_poses import fit_poses, held_out_poses
from clothrf_calibration.images import find_images
from clothrf_calibration.posefile import Poses, match, read_poses
from clothrf_calibration.report import report as report_page
from clothrf_calibration.simcamera import check, check_poses
from clothrf_calibration.terminal import (
    command_line,
    console,
    say,
    track,
    tracked,
    warn,
)
from clothrf_calibration.views import View, load_views
from clothrf_core.files import atomic_write
from clothrf_core.registry import Registry
from clothrf_core.rig import CameraSection
from clothrf_core.types import Float


def pose_pairs(path: Path, setup: str) -> None:
    """Solve and print the camera of pose pairs alone."""
    found = read_poses(path)
    if found.T_camera_board is None:
        raise CalibrationError(f"{path}: expected pairs of 4 x 4 matrices, found single ones")
    G = found.T_base_gripper
    A = G if setup == "fixed" else rigid.inverse(G)
    result = fit_poses(A, found.T_camera_board)
    mm, deg = held_out_poses(A, found.T_camera_board)
    outer = "T_base_camera" if setup == "fixed" else "T_gripper_camera"
    say(f"{outer} =\n{np.array2string(result.X, precision=6, suppress_small=True)}")
    sd = np.sqrt(np.diag(result.X_covariance))
    say(f"one standard deviation: {1e3 * np.linalg.norm(sd[3:]):.2f} mm, "
         f"{np.degrees(np.linalg.norm(sd[:3])):.3f} degrees")  # fmt: skip
    say(f"held out (5 folds): {np.sqrt((mm**2).mean()):.2f} mm, "
         f"{np.sqrt((deg**2).mean()):.3f} degrees RMS")  # fmt: skip
    for n in np.nonzero(result.weights < 0.2)[0]:
        warn(f"pair {n} does not fit the others ({result.shift[n]:.1f} mm, "
              f"{result.turn[n]:.2f} degrees)")  # fmt: skip


def positions_only(
    found: Poses, views: list[View], points: Float, parameters: Float, tables: dict[str, Any],
    pictures: str, setup: str,
) -> dict[str, Any]:  # fmt: skip
    """Tables with the camera solved from gripper positions."""
    if setup != "fixed":
        raise CalibrationError(
            "positions alone place a standing camera only; a camera on the hand needs full poses"
        )
    p = match(found, [v.name for v in views])[:, :3, 3]
    C = np.stack([fit_pose(parameters, points, v)[0] for v in views])
    solved = fit_points(p, C)
    result = dict(tables)
    result["camera"] = {**tables["camera"], "T_world_camera": solved.T_base_camera.tolist()}
    result["extrinsics"] = {
        **provenance(command_line(), pictures=pictures),
        "method": "gripper positions without rotations",
        "T_base_camera": solved.T_base_camera.tolist(),
        "gripper_in_board": solved.point.tolist(),
        "covariance": solved.covariance.tolist(),
        "sd_mm": 1e3 * float(np.sqrt(np.trace(solved.covariance[3:, 3:]))),
        "sd_deg": float(np.degrees(np.sqrt(np.trace(solved.covariance[:3, :3])))),
        "fit_mm": float(np.sqrt((solved.residual_mm**2).mean())),
        "held_out_positions_mm": float(np.sqrt((solved.held_out_mm**2).mean())),
        "views": len(views),
    }
    result["warnings"] = {**tables.get("warnings", {}), "extrinsics": list(solved.warnings)}
    return result


def check_backends(section: CameraSection, backends: list[str] | None, poses: int) -> None:
    """Render a board with every backend, print the comparison, raise if one is off."""
    """Tables with the camera solved from gripper positions."""
    registry = Registry.installed()
    model = section.model()
    trial = Board(kind="chessboard", columns=9, rows=6, square=0.025)
    names = backends or [n for n in ("raster", "sapien") if n in registry.names("camera")]
    table = Table("rendered by", "corners", "RMS px", "mean offset px", "depth mm (99.9 %)", "")
    good = True
    for name in tracked(names, "rendering"):
        renderer = registry.build("camera", name)
        if not hasattr(renderer, "render"):
            raise CalibrationError(f"camera '{name}' renders nothing; expected raster or sapien")
        with renderer:
            found = check(name, renderer, model, trial, check_poses(model, trial, poses))
        good &= found.good
        table.add_row(
            name, str(found.corners), f"{found.rms_px:.3f}",
            f"{found.mean_px[0]:+.3f} {found.mean_px[1]:+.3f}", f"{found.depth_worst_mm:.3f}",
            "good" if found.good else "BAD",
        )  # fmt: skip
    console().print(table)
    if not good:
        raise CalibrationError(
            "expected rendered corners within 0.1 px and depth within 1 mm of the calibrated "
            "camera, found more; see the table"
        )


def write_report(camera: Path, pictures: Path, out: Path, tables: dict[str, Any] | None) -> None:
    """Write the HTML page of a camera file."""
    section, _, _, found = read_intrinsics(camera)
    tables = tables or found
    made, shape, numbers = board_of_tables(tables, camera)
    loaded = load_views(find_images(pictures), made, track=track)
    grippers = None
    if (pictures / "poses.csv").exists():
        grippers = match(read_poses(pictures / "poses.csv"), [v.name for v in loaded.views])
    page = report_page(
        section, tables, made, shape, numbers, loaded.views, title=camera.name, grippers=grippers
    )
    atomic_write(out, page.encode())
    say(f"wrote {out}")
