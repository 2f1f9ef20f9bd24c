"""A `Camera` that plays a folder of pictures, in real time or as fast as they can be read."""

from __future__ import annotations

from collections import deque
from concurrent.futures import Future, ThreadPoolExecutor
from dataclasses import dataclass
from pathlib import Path
from types import TracebackType
from typing import Self

import numpy as np
from numpy.typing import NDArray
from typing_extensions import override

from clothrf_core.camera_file import read_camera_file
from clothrf_core.clock import Clock, WallClock
from clothrf_core.errors import DataError, StaleFrame
from clothrf_core.interfaces import Camera
from clothrf_core.rig import CameraSection, Rig
from clothrf_core.types import CameraModel, Float32, RgbdFrame
from clothrf_realsense.config import FolderConfig
from clothrf_realsense.pictures import PictureFiles, list_pictures, read_color, read_depth

DEFAULT_FPS = 30.0
DEPTH_UNIT = 0.001


@dataclass(frozen=True, slots=True)
class _Decoded:
    rgb: NDArray[np.uint8]
    depth: Float32


class FolderCamera(Camera):
    """Plays the pictures of a folder (`clothrf_realsense.pictures` says how they are named).

    ``fast`` gives every picture in order with the stamps of the folder. ``realtime`` behaves like
    a camera: a picture appears when its time has come, `read` waits for it, and pictures that
    nobody read before the next one appeared are dropped (`dropped` counts them); stamps are then
    those of the clock, so that the age of a frame can be judged.
    """

    def __init__(
        self,
        config: FolderConfig,
        *,
        folder: Path | None = None,
        rig: Rig | None = None,
        clock: Clock | None = None,
    ) -> None:
        self._config = config
        self._folder = (folder or Path()) / config.path
        self._base = folder or Path()
        self._rig = rig
        self._clock = clock or WallClock()
        self._pool: ThreadPoolExecutor | None = None
        self._ahead: deque[tuple[int, Future[_Decoded]]] = deque()
        self._files: list[PictureFiles] = []
        self._offsets: list[int] = []
        self._cycle_ns = 0
        self._section: CameraSection | None = None
        self._model: CameraModel | None = None
        self._next = 0
        self._start_ns: int | None = None
        self.dropped = 0

    @property
    def depth_unit(self) -> float:
        """Metres a count of the depth pictures."""
        return self._section.depth_unit if self._section is not None else DEPTH_UNIT

    def __len__(self) -> int:
        """Pictures in the folder; 0 before it is opened."""
        return len(self._files)

    @override
    def __enter__(self) -> Self:
        self._files = list_pictures(self._folder, depth_required=self._config.depth == "required")
        self._section, self._model = self._find_camera()
        self._offsets, self._cycle_ns = _timeline(self._files, self._config.fps)
        self._pool = ThreadPoolExecutor(max_workers=1, thread_name_prefix="pictures")
        self._next, self._start_ns, self.dropped = 0, None, 0
        self._ahead.clear()
        return self

    @override
    def __exit__(
        self,
        kind: type[BaseException] | None,
        error: BaseException | None,
        trace: TracebackType | None,
    ) -> None:
        if self._pool is not None:
            self._pool.shutdown(wait=True, cancel_futures=True)
        self._pool = None

    @override
    def read(self, timeout_s: float = 1.0) -> RgbdFrame:
        if self._pool is None or self._model is None:
            raise StaleFrame(f"{self._folder}: the camera is closed; use it in a `with` block")
        index = self._next
        self._decode_ahead(index)
        realtime = self._config.playback == "realtime"
        if realtime:
            index = self._newest(index, timeout_s)
        if index >= len(self._files) and not self._config.loop:
            raise StaleFrame(f"{self._folder}: all {len(self._files)} pictures have been played")
        decoded = self._decoded(index)
        if realtime and self._start_ns is None:
            self._start_ns = self._clock.now_ns()
        self._next = index + 1
        stamp = self._offset(index) + (
            self._start_ns if self._start_ns is not None else (self._files[0].stamp_ns or 0)
        )
        frame = RgbdFrame(
            stamp_ns=stamp,
            rgb=decoded.rgb,
            depth=decoded.depth,
            camera=self._model,
        )
        if realtime:  # last, so that a picture is there whole when its time comes
            self._clock.sleep_until_ns(stamp)
        return frame

    def _newest(self, index: int, timeout_s: float) -> int:
        """The newest picture that has appeared, at or after `index`; else `index`, to wait for."""
        if self._start_ns is None:
            return index
        last = None if self._config.loop else len(self._files) - 1
        if last is not None and index > last:
            return index
        now = self._clock.now_ns()
        appears = self._start_ns + self._offset(index)
        if appears - now > timeout_s * 1e9:
            self._clock.sleep_until_ns(now + round(timeout_s * 1e9))
            raise StaleFrame(
                f"{self._folder}: no new picture within {timeout_s:g} s; the next one is due "
                f"after {(appears - now) * 1e-9:.2f} s"
            )
        newest = index
        while (last is None or newest < last) and self._start_ns + self._offset(newest + 1) <= now:
            newest += 1
        self.dropped += newest - index
        return newest

    def _offset(self, index: int) -> int:
        """Nanoseconds from the first picture to the `index`-th one played."""
        lap, i = divmod(index, len(self._files))
        return lap * self._cycle_ns + self._offsets[i]

    def _decode_ahead(self, index: int) -> None:
        """Start decoding the pictures from `index` on.

        `read` calls it before it waits: decoding fills the wait. Started when a picture is handed
        over, it would take the caller's caches and interpreter while the picture is worked on.
        """
        assert self._pool is not None
        self._forget(index)
        first = self._ahead[-1][0] + 1 if self._ahead else index
        for i in range(first, index + self._config.read_ahead):
            if i < len(self._files) or self._config.loop:
                file = self._files[i % len(self._files)]
                self._ahead.append((i, self._pool.submit(self._decode, file)))

    def _decoded(self, index: int) -> _Decoded:
        """The picture `index`, decoded in advance where possible."""
        self._forget(index)
        if not self._ahead:
            self._decode_ahead(index)
        return self._ahead.popleft()[1].result()

    def _forget(self, index: int) -> None:
        """Drop what was decoded of pictures before `index`."""
        while self._ahead and self._ahead[0][0] < index:
            self._ahead.popleft()[1].cancel()

    def _decode(self, file: PictureFiles) -> _Decoded:
        assert self._model is not None
        h, w = self._model.height, self._model.width
        rgb = read_color(file.color)
        if file.depth is None:
            depth = np.full(rgb.shape[:2], np.nan, np.float32)
        else:
            depth = read_depth(file.depth, unit=self.depth_unit)
        for path, shape in ((file.color, rgb.shape[:2]), (file.depth, depth.shape)):
            if shape != (h, w):
                raise DataError(
                    f"{path}: expected {w} x {h} pixels as the camera file says, found "
                    f"{shape[1]} x {shape[0]}"
                )
        rgb.flags.writeable = False
        depth.flags.writeable = False
        return _Decoded(rgb, depth)

    def _find_camera(self) -> tuple[CameraSection | None, CameraModel]:
        if self._config.camera_file is not None:
            section = read_camera_file(self._base / self._config.camera_file)
            return section, section.model()
        beside = self._folder / "camera.toml"
        if beside.exists():
            section = read_camera_file(beside)
            return section, section.model()
        if self._rig is not None and not self._config.guess_intrinsics:
            return self._rig.camera, self._rig.camera.model()
        if not self._config.guess_intrinsics:
            raise DataError(
                f"{self._folder}: expected camera.toml with the intrinsics beside the pictures, "
                "found none; write one with `clothrf calibrate intrinsics`, or set camera_file"
            )
        return None, guessed_camera(*read_color(self._files[0].color).shape[:2])


def guessed_camera(height: int, width: int) -> CameraModel:
    """A camera with the principal point in the middle and f = image width (53 degrees wide)."""
    K = np.array(
        [[width, 0.0, (width - 1) / 2], [0.0, width, (height - 1) / 2], [0.0, 0.0, 1.0]], float
    )
    return CameraModel(
        width=width, height=height, K=K, T_world_camera=np.eye(4), provenance="guessed: f = width"
    )


def _timeline(files: list[PictureFiles], fps: float | None) -> tuple[list[int], int]:
    """Nanoseconds of every picture after the first, and the length of one lap."""
    stamps = [f.stamp_ns for f in files]
    if fps is not None or any(s is None for s in stamps):
        rate = fps or DEFAULT_FPS
        offsets = [round(i * 1e9 / rate) for i in range(len(files))]
        return offsets, round(len(files) * 1e9 / rate)
    offsets = [(s or 0) - (stamps[0] or 0) for s in stamps]
    step = offsets[-1] // max(len(offsets) - 1, 1) or round(1e9 / DEFAULT_FPS)
    return offsets, offsets[-1] + step
