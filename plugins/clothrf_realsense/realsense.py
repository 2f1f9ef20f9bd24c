"""An Intel RealSense as a `Camera`: depth aligned to colour, live or from a recording.

The filters follow the maker's order: depth -> disparity -> spatial -> temporal -> depth. Holes are
not filled: that would invent depth.
"""

from __future__ import annotations

import importlib
import logging
import time
from collections.abc import Callable
from pathlib import Path
from types import TracebackType
from typing import Any, Self

import numpy as np
from typing_extensions import override

from clothrf_core.camera_file import read_camera_file
from clothrf_core.errors import ClothrfError, ConfigError, MissingDependency, StaleFrame
from clothrf_core.interfaces import Camera
from clothrf_core.rig import CameraSection, Rig
from clothrf_core.types import CameraModel, Float, RgbdFrame
from clothrf_realsense.config import RealSenseConfig

NEAR, FAR = 0.05, 5.0

logger = logging.getLogger(__name__)


class CameraNotFound(ClothrfError):
    """No camera is plugged in, or not the one that was asked for."""


class RealSense(Camera):
    """A RealSense camera, or a file recorded from one (`RealSenseConfig.recording`).

    Frames carry colour and depth of one instant, both seen from the colour camera. Live frames
    are stamped with the machine's monotonic clock when they arrive, recorded ones that are not
    played in real time with the recorded time.
    """

    def __init__(
        self,
        config: RealSenseConfig,
        *,
        folder: Path | None = None,
        rig: Rig | None = None,
        now_ns: Callable[[], int] = time.monotonic_ns,
    ) -> None:
        self._rs = _pyrealsense2()
        self._config = config
        self._folder = folder or Path()
        self._section = _section(config, self._folder, rig)
        self._calibrated = config.camera_file is not None
        self._now_ns = now_ns
        self._pipeline: Any = None
        self._profile: Any = None
        self._align: Any = None
        self._filters: list[Any] = []
        self._model: CameraModel | None = None
        self._unit = 0.001
        self._last_ns = -1
        self._last_numbers = (-1, -1)

    @property
    def depth_unit(self) -> float:
        """Metres a count of the sensor's depth picture, as the opened camera says."""
        return self._unit

    @property
    def camera(self) -> CameraModel:
        """The camera model in use; its intrinsics are the factory's unless a file was given.

        Raises:
            StaleFrame: the camera is closed.
        """
        if self._model is None:
            raise StaleFrame("realsense: the camera is closed; use it in a `with` block")
        return self._model

    @override
    def __enter__(self) -> Self:
        rs = self._rs
        pipeline = rs.pipeline()
        self._last_ns, self._last_numbers = -1, (-1, -1)
        if self._config.recording is None and not len(rs.context().query_devices()):
            # pipeline.start would wait 15 s for a device to be plugged in.
            raise CameraNotFound(self._explain("No device connected"))
        try:
            self._profile = pipeline.start(self._streams())
        except RuntimeError as error:
            raise CameraNotFound(self._explain(str(error))) from error
        self._pipeline = pipeline
        try:
            device = self._profile.get_device()
            if device.is_playback():
                device.as_playback().set_real_time(self._config.realtime)
            else:
                for _ in range(self._config.warm_up):
                    pipeline.wait_for_frames(round(self._config.start_timeout_s * 1e3))
            self._unit = _depth_unit(rs, self._profile)
            self._model = self._camera_model()
        except BaseException as error:
            self._stop()
            if isinstance(error, RuntimeError):
                raise StaleFrame(
                    f"{self._name()}: it opened but gave no frame within "
                    f"{self._config.start_timeout_s:g} s ({error}); use a USB 3 port and cable, "
                    "plug it in again"
                ) from error
            raise
        self._align = rs.align(rs.stream.color)
        self._filters = _filters(rs, self._config)
        return self

    @override
    def __exit__(
        self,
        kind: type[BaseException] | None,
        error: BaseException | None,
        trace: TracebackType | None,
    ) -> None:
        self._stop()

    @override
    def read(self, timeout_s: float = 1.0) -> RgbdFrame:
        model = self.camera
        frames = self._frames(timeout_s)
        color, depth = frames.get_color_frame(), frames.get_depth_frame()
        if not color or not depth:
            raise StaleFrame(f"{self._name()}: a frame without colour or depth arrived")
        counts = np.asanyarray(depth.get_data())
        metres = counts.astype(np.float32) * np.float32(self._unit)
        outside = (metres < self._config.min_depth) | (metres > self._config.max_depth)
        metres[outside | (counts == 0)] = np.nan
        return RgbdFrame(
            stamp_ns=self._stamp(color),
            rgb=np.array(np.asanyarray(color.get_data()), np.uint8),
            depth=metres,
            camera=model,
        )

    def _frames(self, timeout_s: float) -> Any:
        """The next pair of colour and filtered depth, aligned."""
        deadline = time.monotonic() + timeout_s
        while True:
            left = max(deadline - time.monotonic(), 0.001)
            ok, frames = self._pipeline.try_wait_for_frames(max(round(left * 1e3), 1))
            if not ok:
                self._refuse(timeout_s)
            if self._fresh(frames):
                return self._align.process(self._filtered(frames)).as_frameset()
            if time.monotonic() > deadline:
                self._refuse(timeout_s)

    def _fresh(self, frames: Any) -> bool:
        """Both pictures are new and of one instant; librealsense repeats the slower stream's."""
        color, depth = frames.get_color_frame(), frames.get_depth_frame()
        if not color or not depth:
            return False
        apart_ms = abs(color.get_timestamp() - depth.get_timestamp())
        same_clock = color.get_frame_timestamp_domain() == depth.get_frame_timestamp_domain()
        if same_clock and apart_ms > 500.0 / self._config.fps:
            return False
        numbers = (color.get_frame_number(), depth.get_frame_number())
        if numbers[0] <= self._last_numbers[0] or numbers[1] <= self._last_numbers[1]:
            return False
        self._last_numbers = numbers
        return True

    def _refuse(self, timeout_s: float) -> None:
        playback = self._profile.get_device().is_playback()
        if playback:
            raise StaleFrame(f"{self._name()}: the recording has ended")
        raise StaleFrame(
            f"{self._name()}: no frame within {timeout_s:g} s; was the camera unplugged?"
        )

    def _filtered(self, frames: Any) -> Any:
        for part in self._filters:
            frames = part.process(frames).as_frameset()
        return frames

    def _stamp(self, frame: Any) -> int:
        live = self._config.realtime or not self._profile.get_device().is_playback()
        stamp = self._now_ns() if live else round(frame.get_timestamp() * 1e6)
        self._last_ns = max(stamp, self._last_ns + 1)
        return self._last_ns

    def _streams(self) -> Any:
        rs, c = self._rs, self._config
        streams = rs.config()
        if c.recording is not None:
            path = self._folder / c.recording
            if not path.exists():
                raise CameraNotFound(f"{path}: expected a recording, found none")
            rs.config.enable_device_from_file(streams, str(path), repeat_playback=False)
            return streams
        if c.serial:
            streams.enable_device(c.serial)
        if c.record_to is not None:
            target = self._folder / c.record_to
            if target.exists():
                raise ConfigError(f"{target}: a recording of that name exists; choose another name")
            streams.enable_record_to_file(str(target))
        streams.enable_stream(rs.stream.depth, c.depth_width, c.depth_height, rs.format.z16, c.fps)
        streams.enable_stream(rs.stream.color, c.width, c.height, rs.format.rgb8, c.fps)
        return streams

    def _camera_model(self) -> CameraModel:
        """Calibrated intrinsics if a file was given, else the factory's; the pose of the rig."""
        stream = self._profile.get_stream(self._rs.stream.color).as_video_stream_profile()
        factory = stream.get_intrinsics()
        size = (factory.width, factory.height)
        section = self._section
        T = np.eye(4) if section is None else np.array(section.T_world_camera, float)
        near, far = (NEAR, FAR) if section is None else (section.near, section.far)
        if section is not None and self._calibrated:
            if (section.width, section.height) != size:
                raise ConfigError(
                    f"{self._config.camera_file}: expected intrinsics of {size[0]} x {size[1]} as "
                    f"the camera delivers, found {section.width} x {section.height}; calibrate at "
                    "that resolution or change width and height"
                )
            return section.model()
        K, distortion = _factory(self._rs, factory)
        return CameraModel(
            width=size[0],
            height=size[1],
            K=K,
            T_world_camera=T,
            near=near,
            far=far,
            distortion=distortion,
            provenance=f"factory intrinsics of {self._name()}",
        )

    def _name(self) -> str:
        if self._config.recording is not None:
            return str(self._config.recording)
        return f"realsense {self._config.serial}".strip()

    def _explain(self, reason: str) -> str:
        c = self._config
        if c.recording is not None:
            return (
                f"{c.recording}: expected a recording made by librealsense ({reason}); files older "
                "than 2.58 end in .bag, newer ones in .db3"
            )
        found = [
            d.get_info(self._rs.camera_info.serial_number)
            for d in self._rs.context().query_devices()
        ]
        if not found:
            return (
                "realsense: no camera is plugged in; check the USB 3 cable and the udev rules, "
                "or play a recording with `recording`"
            )
        if c.serial and c.serial not in found:
            return f"realsense: no camera {c.serial}; plugged in: {', '.join(found)}"
        return (
            f"realsense {', '.join(found)}: cannot deliver {c.width} x {c.height} colour with "
            f"{c.depth_width} x {c.depth_height} depth at {c.fps} fps ({reason}); choose a mode "
            "that the camera has, and a USB 3 port"
        )

    def _stop(self) -> None:
        if self._pipeline is not None:
            self._pipeline.stop()
        self._pipeline = self._model = None


def _pyrealsense2() -> Any:
    try:
        return importlib.import_module("pyrealsense2")
    except ImportError as error:
        if "libusb" in str(error):
            raise MissingDependency(
                "camera 'realsense' needs the system library libusb-1.0, which is not installed. "
                "Install it with: apt install libusb-1.0-0"
            ) from error
        raise MissingDependency(
            "camera 'realsense' needs 'pyrealsense2', which is not installed. "
            "Install it with: pip install 'clothrf[realsense]'"
        ) from error


def _section(config: RealSenseConfig, folder: Path, rig: Rig | None) -> CameraSection | None:
    if config.camera_file is not None:
        return read_camera_file(folder / config.camera_file)
    return rig.camera if rig is not None else None


def _depth_unit(rs: Any, profile: Any) -> float:
    for sensor in profile.get_device().query_sensors():
        if sensor.supports(rs.option.depth_units):
            return float(sensor.get_option(rs.option.depth_units))
    return 0.001


def _filters(rs: Any, config: RealSenseConfig) -> list[Any]:
    inner = []
    if config.spatial:
        inner.append(rs.spatial_filter())
    if config.temporal:
        inner.append(rs.temporal_filter())
    if not inner:
        return []
    to_disparity, to_depth = rs.disparity_transform(True), rs.disparity_transform(False)
    return [to_disparity, *inner, to_depth]


def _factory(rs: Any, intrinsics: Any) -> tuple[Float, Float]:
    """(3, 3) K and OpenCV coefficients of a librealsense intrinsics record.

    librealsense's brown_conrady is OpenCV's model; D400 colour says inverse_brown_conrady with
    zero coefficients, which is none (librealsense issue 7300).
    """
    K = np.array(
        [
            [intrinsics.fx, 0.0, intrinsics.ppx],
            [0.0, intrinsics.fy, intrinsics.ppy],
            [0.0, 0.0, 1.0],
        ],
        float,
    )
    coefficients = np.array(intrinsics.coeffs, float)
    if not coefficients.any():
        return K, np.zeros(0)
    if intrinsics.model != rs.distortion.brown_conrady:
        logger.warning(
            "realsense: factory distortion model %s is used as brown_conrady (0.002 px for usual "
            "coefficients); calibrate for better",
            intrinsics.model,
        )
    return K, coefficients
