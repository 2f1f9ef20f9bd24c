"""Roll-outs as an MCAP of ROS 2 messages, which Foxglove and ROS 2 tools open as it is.

==========================  =======================================================================
/clothrf/grasp              geometry_msgs/PoseArray: where the robot held the cloth
/clothrf/wanted/TASK        geometry_msgs/PoseArray: the expert's x* of each task
/clothrf/sent               geometry_msgs/PoseArray: the limited targets that were sent
/clothrf/hands              geometry_msgs/PoseArray: where the person held it
/clothrf/camera/image       sensor_msgs/Image, rgb8 (with pictures)
/clothrf/camera/depth       sensor_msgs/Image, 32FC1 metres, NaN = not measured (with pictures)
/clothrf/camera/info        sensor_msgs/CameraInfo (with pictures)
==========================  =======================================================================

The roll-outs follow each other with a second of nothing between them; the time starts at zero.
"""

from __future__ import annotations

import os
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from functools import partial
from pathlib import Path
from typing import IO, Any

import numpy as np
from mcap.writer import CompressionType
from mcap_ros2.writer import Writer

from clothrf_core.dataset import Rollout
from clothrf_core.errors import DataError
from clothrf_core.files import sync_folder
from clothrf_core.registry import Registry
from clothrf_core.types import Float, RgbdFrame
from clothrf_lerobot.source import Source

FRAME = "world"
CAMERA = "camera"
PAUSE_S = 1.0

RULE = "=" * 80
HEADER = f"""{RULE}
MSG: std_msgs/Header
builtin_interfaces/Time stamp
string frame_id
{RULE}
MSG: builtin_interfaces/Time
int32 sec
uint32 nanosec
"""
TYPES = {
    "geometry_msgs/msg/PoseArray": f"""std_msgs/Header header
geometry_msgs/Pose[] poses
{RULE}
MSG: geometry_msgs/Pose
geometry_msgs/Point position
geometry_msgs/Quaternion orientation
{RULE}
MSG: geometry_msgs/Point
float64 x
float64 y
float64 z
{RULE}
MSG: geometry_msgs/Quaternion
float64 x
float64 y
float64 z
float64 w
{HEADER}""",
    "sensor_msgs/msg/Image": f"""std_msgs/Header header
uint32 height
uint32 width
string encoding
uint8 is_bigendian
uint32 step
uint8[] data
{HEADER}""",
    "sensor_msgs/msg/CameraInfo": f"""std_msgs/Header header
uint32 height
uint32 width
string distortion_model
float64[] d
float64[9] k
float64[9] r
float64[12] p
uint32 binning_x
uint32 binning_y
sensor_msgs/RegionOfInterest roi
{RULE}
MSG: sensor_msgs/RegionOfInterest
uint32 x_offset
uint32 y_offset
uint32 height
uint32 width
bool do_rectify
{HEADER}""",
}


class Bag:
    """Messages on their way into a file."""

    def __init__(self, stream: IO[bytes]) -> None:
        self._writer = Writer(stream, chunk_size=1 << 20, compression=CompressionType.ZSTD)
        self._schemas = {
            name: self._writer.register_msgdef(name, text) for name, text in TYPES.items()
        }

    def points(self, topic: str, points: Float, stamp_ns: int) -> None:
        """(n, 3) world points as poses without a rotation."""
        still = {"x": 0.0, "y": 0.0, "z": 0.0, "w": 1.0}
        poses = [
            {"position": {"x": x, "y": y, "z": z}, "orientation": still}
            for x, y, z in np.asarray(points).tolist()
        ]
        self._add("geometry_msgs/msg/PoseArray", topic, FRAME, stamp_ns, {"poses": poses})

    def frame(self, frame: RgbdFrame, stamp_ns: int) -> None:
        """Colour, depth and the camera's numbers."""
        camera = frame.camera
        size = {"height": camera.height, "width": camera.width}
        for topic, encoding, picture in (
            ("image", "rgb8", np.asarray(frame.rgb)),
            ("depth", "32FC1", np.asarray(frame.depth, "<f4")),
        ):
            data = picture.tobytes()
            body = {"encoding": encoding, "is_bigendian": 0, "step": len(data) // camera.height}
            self._add(
                "sensor_msgs/msg/Image",
                f"/clothrf/camera/{topic}",
                CAMERA,
                stamp_ns,
                {**size, **body, "data": data},
            )
        K = np.asarray(camera.K)
        self._add(
            "sensor_msgs/msg/CameraInfo",
            "/clothrf/camera/info",
            CAMERA,
            stamp_ns,
            {
                **size,
                "distortion_model": "rational_polynomial" if camera.distortion.size == 8
                else "plumb_bob",
                "d": camera.distortion.tolist(),
                "k": K.ravel().tolist(),
                "r": np.eye(3).ravel().tolist(),
                "p": np.hstack([K, np.zeros((3, 1))]).ravel().tolist(),
                "binning_x": 0,
                "binning_y": 0,
                "roi": {"x_offset": 0, "y_offset": 0, "height": 0, "width": 0, "do_rectify": False},
            },
        )  # fmt: skip

    def _add(
        self, kind: str, topic: str, frame_id: str, stamp_ns: int, body: dict[str, Any]
    ) -> None:
        seconds, nanoseconds = divmod(stamp_ns, 1_000_000_000)
        header = {"stamp": {"sec": seconds, "nanosec": nanoseconds}, "frame_id": frame_id}
        self._writer.write_message(
            topic, self._schemas[kind], {"header": header, **body}, log_time=stamp_ns
        )

    def finish(self) -> None:
        """Write the index."""
        self._writer.finish()  # type: ignore[no-untyped-call]


def export(
    source: Source,
    registry: Registry,
    out: Path,
    *,
    pictures: bool = False,
    on_episode: Callable[[], None] = lambda: None,
) -> int:
    """Write all roll-outs of `source` to the file `out`; returns how many.

    Raises:
        DataError: `out` exists, or a roll-out is damaged or cannot be drawn again.
    """
    jobs = {}
    if pictures:
        from clothrf_lerobot.pictures import replays_of

        jobs = dict(replays_of(source, registry).jobs)
    start_ns, count = 0, 0
    with _new_file(out) as stream:
        bag = Bag(stream)
        for name, rollout, _ in source.rollouts():
            stamps = [start_ns + round(i * 1e9 / source.fps) for i in range(len(rollout))]
            _rows(bag, rollout, stamps)
            if pictures:
                from clothrf_lerobot.pictures import replay

                replay(jobs[name], rollout, partial(_framed, bag, iter(stamps)))
            start_ns = stamps[-1] + round(PAUSE_S * 1e9)
            count += 1
            on_episode()
        bag.finish()
    return count


def _framed(bag: Bag, stamps: Iterator[int], frame: RgbdFrame) -> None:
    bag.frame(frame, next(stamps))


def _rows(bag: Bag, rollout: Rollout, stamps: list[int]) -> None:
    for i, stamp_ns in enumerate(stamps):
        bag.points("/clothrf/grasp", rollout.grasps[i], stamp_ns)
        for t, task in enumerate(rollout.meta["tasks"]):
            bag.points(f"/clothrf/wanted/{task}", rollout.labels[i, t], stamp_ns)
        bag.points("/clothrf/sent", rollout.executed[i], stamp_ns)
        bag.points("/clothrf/hands", rollout.hands[i], stamp_ns)


@contextmanager
def _new_file(path: Path) -> Iterator[IO[bytes]]:
    """A file that gets its name when it is whole, and never replaces another."""
    if path.exists():
        raise DataError(f"{path}: expected a new file name, found a file; choose another")
    path.parent.mkdir(parents=True, exist_ok=True)
    temporary = path.with_name(f".{path.name}.{os.getpid()}.tmp")
    try:
        with temporary.open("wb") as stream:
            yield stream
            stream.flush()
            os.fsync(stream.fileno())
        temporary.replace(path)
        sync_folder(path.parent)
    finally:
        temporary.unlink(missing_ok=True)
