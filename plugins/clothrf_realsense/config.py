"""What the cameras of this plugin can be told."""

from __future__ import annotations

from pathlib import Path
from typing import Literal

from pydantic import Field

from clothrf_core.rig import Section


class FolderConfig(Section):
    """A folder of pictures, played as a camera."""

    path: Path = Field(description="folder with *_color.png (or .jpg) and *_depth.png")
    camera_file: Path | None = Field(
        None, description="intrinsics; none = camera.toml in the folder, or the rig's camera"
    )
    playback: Literal["fast", "realtime"] = Field(
        "fast",
        description="fast: every picture, as fast as it is read; realtime: as a camera would give "
        "them, pictures nobody read in time are dropped",
    )
    fps: float | None = Field(
        None, gt=0.0, description="pictures a second; none = as the time stamps say, else 30"
    )
    loop: bool = Field(False, description="start again at the end; stamps go on increasing")
    depth: Literal["required", "optional"] = Field(
        "required", description="optional: pictures without depth give NaN"
    )
    guess_intrinsics: bool = Field(
        False,
        description="without any camera file, pretend f = image width (for calibration pictures)",
    )
    read_ahead: int = Field(4, ge=1, le=64, description="pictures decoded in advance")


class RealSenseConfig(Section):
    """An Intel RealSense camera, or a recording of one."""

    serial: str = Field("", description="serial number; empty = the only one plugged in")
    recording: Path | None = Field(None, description="play this .db3 (or .bag) instead of a device")
    realtime: bool = Field(True, description="recordings: at their own pace, frames may drop")
    record_to: Path | None = Field(None, description="also record the streams to this .db3 file")
    width: int = Field(640, ge=1, description="colour width, pixels")
    height: int = Field(480, ge=1, description="colour height, pixels")
    depth_width: int = Field(640, ge=1, description="depth width before alignment, pixels")
    depth_height: int = Field(480, ge=1, description="depth height before alignment, pixels")
    fps: int = Field(30, ge=1, description="frames a second of both streams")
    camera_file: Path | None = Field(
        None, description="calibrated intrinsics and pose; none = factory intrinsics, rig's pose"
    )
    spatial: bool = Field(False, description="edge-preserving spatial filter")
    temporal: bool = Field(False, description="temporal filter; smears what moves")
    min_depth: float = Field(0.1, ge=0.0, description="nearer readings become NaN, m")
    max_depth: float = Field(4.0, gt=0.0, description="farther readings become NaN, m")
    warm_up: int = Field(15, ge=0, description="frames thrown away while exposure settles (live)")
    start_timeout_s: float = Field(5.0, gt=0.0, description="longest wait for the first frame")
