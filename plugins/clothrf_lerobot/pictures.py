"""The pictures of a roll-out, drawn again: same seed, same states, same pictures.

A data set keeps features, not pictures. A roll-out is done again from its seed, and unless every
array comes out as it was stored, bit for bit, its pictures are refused: they would be of something
else.
"""

from __future__ import annotations

import dataclasses
import io
from collections.abc import Callable, Mapping
from fractions import Fraction
from pathlib import Path
from typing import Any

import av
import numpy as np
from numpy.typing import NDArray
from typing_extensions import override

from clothrf_core import imitation
from clothrf_core.compose import cached_policy, cached_workshop
from clothrf_core.dataset import ARRAYS, Rollout
from clothrf_core.errors import DataError
from clothrf_core.opening import CameraAround
from clothrf_core.registry import Registry
from clothrf_core.rollout import RolloutJob, roll_out
from clothrf_core.simulated import SimulatedCamera
from clothrf_core.types import Float32, RgbdFrame
from clothrf_lerobot.layout import COLOUR, DEPTH
from clothrf_lerobot.source import Source
from clothrf_lerobot.stats import picture_stats

CODECS = ("libx264", "libsvtav1", "mpeg4")  # LeRobot reads all; players know the first best
EVERY = 4  # pixels of a row or column that statistics skip


class Watched(SimulatedCamera):
    """A simulated camera whose frames are also shown to somebody else."""

    def __init__(self, camera: SimulatedCamera, show: Callable[[RgbdFrame], None]) -> None:
        CameraAround.__init__(self, camera)
        self._camera = camera
        self._show = show

    @override
    def read(self, timeout_s: float = 1.0) -> RgbdFrame:
        frame = self._camera.read(timeout_s)
        self._show(frame)
        return frame


@dataclasses.dataclass(frozen=True)
class Replays:
    """How to do the roll-outs of a run again.

    Attributes:
        jobs: the job that made each roll-out, by its name.
        size: height and width of the pictures.
    """

    jobs: Mapping[str, RolloutJob]
    size: tuple[int, int]

    def draw(self, name: str, stored: Rollout, fps: float) -> Pictures:
        """All pictures of one roll-out.

        Raises:
            DataError: see `replay`; or the run's config no longer knows the roll-out.
        """
        if name not in self.jobs:
            raise DataError(f"{name}: expected one of the run's own roll-outs, found another")
        return draw(self.jobs[name], stored, fps)

    def features(self, fps: float) -> dict[str, Any]:
        """The entries of ``info.json`` for colour and depth."""
        height, width = self.size
        names = ["height", "width", "channels"]
        film = {
            "video.height": height,
            "video.width": width,
            "video.codec": av.Codec(codec(), "w").canonical_name,
            "video.pix_fmt": "yuv420p",
            "video.fps": fps,
            "video.channels": 3,
            "is_depth_map": False,
            "has_audio": False,
        }
        depth = {"is_depth_map": True, "depth_unit": "mm"}
        return {
            COLOUR: {"dtype": "video", "shape": [*self.size, 3], "names": names, "info": film},
            DEPTH: {"dtype": "image", "shape": [*self.size, 1], "names": names, "info": depth},
        }


def replays_of(source: Source, registry: Registry) -> Replays:
    """How the roll-outs of a run were made.

    Raises:
        DataError: they stand alone, so nothing says it; or their pictures cannot be filmed.
    """
    run = source.run
    if run is None:
        raise DataError(
            f"{source.dataset.folder}: pictures are drawn from a run (with experiment.toml); "
            "name the run folder, or leave --pictures out"
        )
    resolved = run.resolved(registry)
    camera = resolved.rig.camera.model()
    if camera.width % 2 or camera.height % 2:
        raise DataError(
            f"rig.camera: expected an even width and height for a film, found {camera.width} x "
            f"{camera.height}; leave --pictures out"
        )
    jobs = imitation.held_out_jobs(run, resolved, source.dataset)
    for iteration in range(1, resolved.experiment.training.iterations + 1):
        jobs += imitation.iteration_jobs(run, resolved, source.dataset, iteration)
    named = {source.name(Path(job.out)): job for job in jobs}
    return Replays(named, (camera.height, camera.width))


def replay(job: RolloutJob, stored: Rollout, show: Callable[[RgbdFrame], None]) -> None:
    """Do a roll-out again and show its pictures.

    Raises:
        DataError: it came out differently: other code, packages or policy than then.
    """
    shop = cached_workshop(job.config)
    watched = dataclasses.replace(shop, camera=Watched(shop.camera, show))
    again = roll_out(watched, job, cached_policy(job.policy) if job.policy else None)
    different = [
        name
        for name in ARRAYS
        if np.asarray(getattr(again, name)).tobytes() != np.asarray(getattr(stored, name)).tobytes()
    ]
    if different:
        raise DataError(
            f"{job.name}: done again it gives other {', '.join(different)} than were stored, so "
            "its pictures would be of something else. Use the versions of versions.json, or leave "
            "--pictures out"
        )


class Film:
    """Colour pictures as one MP4, frame i at i / fps seconds."""

    def __init__(self, width: int, height: int, fps: float) -> None:
        self._bytes = io.BytesIO()
        self._container = av.open(self._bytes, "w", format="mp4")
        rate = Fraction(fps).limit_denominator(1000)
        stream: Any = self._container.add_stream(codec(), rate=rate)
        stream.width, stream.height, stream.pix_fmt = width, height, "yuv420p"
        stream.options = {"g": "2", "crf": "20"}
        self._stream = stream

    def add(self, rgb: NDArray[np.uint8]) -> None:
        """One (H, W, 3) picture."""
        frame = av.VideoFrame.from_ndarray(np.ascontiguousarray(rgb), format="rgb24")
        self._container.mux(self._stream.encode(frame))

    def finish(self) -> bytes:
        """The file."""
        self._container.mux(self._stream.encode(None))
        self._container.close()
        return self._bytes.getvalue()


def codec() -> str:
    """The first of `CODECS` that this build of FFmpeg can write.

    Raises:
        DataError: it can write none.
    """
    for name in CODECS:
        if name in av.codecs_available:
            return name
    raise DataError(f"expected an FFmpeg that writes one of {', '.join(CODECS)}, found none in av")


def depth_png(depth: Float32) -> bytes:
    """(H, W) float32 metres as a 16-bit grey PNG of millimetres; 0 = not measured, as sensors say.

    LeRobot reads such a column as millimetres (``depth_unit``).
    """
    height, width = depth.shape
    millimetres = np.nan_to_num(np.rint(1e3 * np.asarray(depth, np.float64)), nan=0.0)
    values = np.clip(millimetres, 0, 65535).astype(np.uint16)
    context = av.CodecContext.create("png", "w")
    context.width, context.height = width, height
    context.pix_fmt, context.time_base = "gray16be", Fraction(1, 1)
    frame = av.VideoFrame.from_ndarray(values, format="gray16be")
    return b"".join(bytes(packet) for packet in (*context.encode(frame), *context.encode(None)))


@dataclasses.dataclass(frozen=True)
class Pictures:
    """What one roll-out looked like.

    Attributes:
        film: MP4 of the colour pictures.
        depths: a PNG a frame.
        stats: of colour in [0, 1] and depth in millimetres, as LeRobot keeps them.
    """

    film: bytes
    depths: tuple[bytes, ...]
    stats: Mapping[str, dict[str, NDArray[Any]]]


def draw(job: RolloutJob, stored: Rollout, fps: float) -> Pictures:
    """All pictures of a roll-out.

    Raises:
        DataError: see `replay`.
    """
    films: list[Film] = []
    depths: list[bytes] = []
    colours: list[NDArray[Any]] = []
    ranges: list[NDArray[Any]] = []

    def show(frame: RgbdFrame) -> None:
        if not films:
            films.append(Film(frame.camera.width, frame.camera.height, fps))
        films[0].add(frame.rgb)
        depths.append(depth_png(frame.depth))
        colours.append(np.asarray(frame.rgb)[::EVERY, ::EVERY].reshape(-1, 3))
        ranges.append(1e3 * np.nan_to_num(frame.depth)[::EVERY, ::EVERY].reshape(-1, 1))

    replay(job, stored, show)
    return Pictures(
        film=films[0].finish(),
        depths=tuple(depths),
        stats={
            COLOUR: picture_stats(np.concatenate(colours), len(depths), 255.0),
            DEPTH: picture_stats(np.concatenate(ranges), len(depths), 1.0),
        },
    )
