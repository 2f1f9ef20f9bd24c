"""The folder that `collect` fills: pictures, board, camera and poses; nothing in it is replaced.

::

    board.toml            the board
    camera.toml           what the camera said about itself (read by the `folder` camera too)
    0001_color.png        colour
    0001_depth.png        16-bit depth, if the camera has depth
    stamps.csv            name,stamp_ns
    poses.csv             name,x,y,z,qx,qy,qz,qw   gripper in the robot's base, if there is a robot;
                          name,x,y,z where the robot tells positions only
"""

from __future__ import annotations

from pathlib import Path

import numpy as np
import tomli_w

from clothrf_calibration.boardprint import board_toml
from clothrf_calibration.boards import Board, read_board
from clothrf_calibration.errors import CalibrationError
from clothrf_calibration.images import write_png
from clothrf_calibration.posefile import csv_line
from clothrf_core.files import atomic_write
from clothrf_core.types import Float, RgbdFrame

POSES_HEADER = "name,x,y,z,qx,qy,qz,qw\n"
POSITIONS_HEADER = "name,x,y,z\n"
STAMPS_HEADER = "name,stamp_ns\n"


class Session:
    """A folder of collected pictures that grows; opening it again goes on where it ended."""

    def __init__(self, folder: Path, board: Board, *, depth_unit: float = 0.001) -> None:
        self.folder = folder
        self._unit = depth_unit
        known = folder / "board.toml"
        if known.exists():
            there = read_board(known)
            if there != board.model_copy(update={"marker": there.marker}):
                raise CalibrationError(
                    f"{folder}: expected pictures of {board.text}, found a session of "
                    f"{there.text}; take another folder"
                )
        folder.mkdir(parents=True, exist_ok=True)
        if not known.exists():
            atomic_write(known, board_toml(board).encode())
        numbers = [int(p.name[:4]) for p in folder.glob("[0-9][0-9][0-9][0-9]_*")]
        self._next = max(numbers, default=0) + 1

    @property
    def count(self) -> int:
        """Pictures in the folder."""
        return len(list(self.folder.glob("*_color.png")))

    def add(self, frame: RgbdFrame, T_base_gripper: Float | None = None) -> str:
        """Keep a picture and the pose it was taken at; returns its name.

        Args:
            frame: the picture.
            T_base_gripper: (4, 4), or (3,) where the robot tells positions only.
        """
        name = f"{self._next:04d}"
        self._next += 1
        if np.isfinite(frame.depth).any():
            counts = np.nan_to_num(frame.depth, nan=0.0) / self._unit
            write_png(
                self.folder / f"{name}_depth.png",
                np.clip(np.round(counts), 0, 65535).astype(np.uint16),
            )
        self._append("stamps.csv", STAMPS_HEADER, f"{name},{frame.stamp_ns}\n")
        if T_base_gripper is not None:
            self._keep_pose(name, T_base_gripper)
        self._keep_camera(frame)
        # The colour picture comes last: where it is, everything else is there.
        write_png(self.folder / f"{name}_color.png", np.asarray(frame.rgb))
        return name

    def _append(self, file: str, header: str, line: str) -> None:
        path = self.folder / file
        before = path.read_text(encoding="utf-8") if path.exists() else header
        if not before.startswith(header):
            raise CalibrationError(
                f"{path}: expected the columns {header.strip()}, found "
                f"{before.partition(chr(10))[0]}; take another folder"
            )
        atomic_write(path, (before + line).encode())

    def _keep_pose(self, name: str, pose: Float) -> None:
        if pose.shape == (3,):
            line = ",".join([name, *(f"{float(n):.9g}" for n in pose)]) + "\n"
            self._append("poses.csv", POSITIONS_HEADER, line)
        else:
            self._append("poses.csv", POSES_HEADER, csv_line(name, pose))

    def _keep_camera(self, frame: RgbdFrame) -> None:
        path = self.folder / "camera.toml"
        if path.exists():
            return
        camera = frame.camera
        section = {
            "width": camera.width,
            "height": camera.height,
            "K": camera.K.tolist(),
            "distortion": camera.distortion.tolist(),
            "T_world_camera": camera.T_world_camera.tolist(),
            "near": camera.near,
            "far": camera.far,
            "depth_unit": self._unit,
            "provenance": camera.provenance or "as the camera said, not calibrated",
        }
        atomic_write(path, tomli_w.dumps({"kind": "camera", "camera": section}).encode())
