"""Cameras that deliver real pictures: an Intel RealSense, and a folder of recorded pictures."""

from __future__ import annotations

from collections.abc import Sequence

from clothrf_core.hookspecs import hookimpl
from clothrf_core.interfaces import Camera
from clothrf_core.provider import BuildContext, Provider
from clothrf_realsense.config import FolderConfig, RealSenseConfig


@hookimpl
def clothrf_cameras() -> Sequence[Provider[Camera]]:
    """``realsense`` and ``folder``."""
    return [
        Provider(
            name="realsense",
            summary="Intel RealSense: depth aligned to colour, live or from a recording",
            build=_realsense,
            config=RealSenseConfig,
            extra="realsense",
        ),
        Provider(
            name="folder",
            summary="plays a folder of *_color.png and 16-bit *_depth.png with a camera.toml",
            build=_folder,
            config=FolderConfig,
            extra="vision",
        ),
    ]


def _realsense(config: RealSenseConfig, context: BuildContext) -> Camera:
    from clothrf_realsense.realsense import RealSense

    return RealSense(config, folder=context.folder, rig=context.rig)


def _folder(config: FolderConfig, context: BuildContext) -> Camera:
    from clothrf_realsense.folder import FolderCamera

    return FolderCamera(config, folder=context.folder, rig=context.rig)
