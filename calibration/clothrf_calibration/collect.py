"""Takes board pictures that differ from each other, and says which are still missing."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass, field
from typing import Protocol, runtime_checkable

import cv2
import numpy as np

from clothrf_calibration.boardpose import fit_pose
from clothrf_calibration.boards import Board
from clothrf_calibration.coverage import Coverage, advice, coverage
from clothrf_calibration.detect import Detection, detect
from clothrf_calibration.errors import CalibrationError
from clothrf_calibration.lens import vector
from clothrf_calibration.session import Session
from clothrf_calibration.views import View
from clothrf_core.errors import StaleFrame
from clothrf_core.interfaces import Camera
from clothrf_core.types import CameraModel, Float, RgbdFrame

# A picture is new if the board's middle, size or tilt differs by this much from all others.
DIFFERENT = 0.12
STILL_PX = 1.5


@runtime_checkable
class PosedRobot(Protocol):
    """A robot that tells the full pose of its grippers, which hand-eye calibration needs."""

    def poses(self) -> Float:
        """(G, 4, 4) T_base_gripper."""


@dataclass(frozen=True, slots=True, eq=False)
class Progress:
    """What a person with a board in hand wants to see.

    Attributes:
        kept: pictures kept in this run.
        wanted: how many are wanted.
        seen: coverage so far, None before the first picture.
        advice: what to do next, most useful first.
        last: what became of the newest frame.
    """

    kept: int
    wanted: int
    seen: Coverage | None
    advice: list[str] = field(default_factory=list)
    last: str = ""


def collect(
    camera: Camera,
    board: Board,
    session: Session,
    *,
    wanted: int = 25,
    every: bool = False,
    pose: Callable[[], Float] | None = None,
    tell: Callable[[Progress], None] | None = None,
    timeout_s: float = 2.0,
) -> Progress:
    """Keep `wanted` pictures of the board that differ from each other.

    Args:
        camera: opened; read until enough pictures are kept or it ends.
        board: what to look for.
        session: where pictures go; each is safe once it is counted.
        wanted: pictures to keep.
        every: keep every picture with a board (a folder), not only still and new ones.
        pose: T_base_gripper (4, 4) at the moment; called for every picture kept.
        tell: called after every frame.
        timeout_s: for `camera.read`.

    Raises:
        CalibrationError: the camera ended and no board was in any picture.
    """
    views: list[View] = []
    poses: list[Float] = []
    state = Progress(0, wanted, None, [], "waiting for the board")
    before: Detection | None = None
    frames = 0
    while len(views) < wanted:
        try:
            frame = camera.read(timeout_s)
        except StaleFrame:
            if frames == 0:
                raise
            break
        frames += 1
        found = detect(board, _grey(frame))
        still = every or _still(before, found)
        before = found
        last = "no board in the picture"
        if found is not None:
            view = View("", (frame.camera.width, frame.camera.height), found.ids, found.pixels)
            T = _pose(frame.camera, board, view)
            if not still:
                last = "hold still"
            elif not every and not _new(view, T, views, poses):
                last = "seen already: move on"
            else:
                name = session.add(frame, pose() if pose is not None else None)
                views.append(view)
                poses.append(T)
                last = f"kept as {name}"
        seen = coverage(views, np.stack(poses), board.points) if views else None
        state = Progress(len(views), wanted, seen, advice(seen) if seen else [], last)
        if tell is not None:
            tell(state)
    if not views:
        raise CalibrationError(
            f"no board {board.text} in any of {frames} frames; is it in view, sharp and lit, and "
            "is --board right?"
        )
    return state


def _grey(frame: RgbdFrame) -> np.ndarray[tuple[int, ...], np.dtype[np.uint8]]:
    return np.asarray(
        cv2.cvtColor(src=np.ascontiguousarray(frame.rgb), code=cv2.COLOR_RGB2GRAY), np.uint8
    )


def _pose(camera: CameraModel, board: Board, view: View) -> Float:
    return fit_pose(vector(camera.K, camera.distortion), board.points, view)[0]


def _still(before: Detection | None, now: Detection | None) -> bool:
    if before is None or now is None:
        return False
    common, a, b = np.intersect1d(before.ids, now.ids, return_indices=True)
    if len(common) < 4:
        return False
    moved = np.linalg.norm(before.pixels[a] - now.pixels[b], axis=1)
    return float(np.median(moved)) < STILL_PX


def _new(view: View, T: Float, views: list[View], poses: list[Float]) -> bool:
    """Differs in place, size or direction from every picture kept."""
    size = np.array(view.size, float)
    middle, extent = view.pixels.mean(axis=0) / size, np.ptp(view.pixels, axis=0).max() / size[0]
    for other, U in zip(views, poses, strict=True):
        place = float(np.abs(other.pixels.mean(axis=0) / size - middle).max())
        grown = abs(float(np.ptp(other.pixels, axis=0).max() / size[0] - extent))
        cosine = float(np.clip((np.trace(T[:3, :3].T @ U[:3, :3]) - 1) / 2, -1, 1))
        if max(place, grown, float(np.arccos(cosine)) / 1.5) < DIFFERENT:
            return False
    return True
