"""Where everything stands in a LeRobotDataset v3.0, and a strict reader of its ``info.json``.

::

    meta/info.json                                  features, counts, frame rate
    meta/stats.json                                 of every feature over all episodes
    meta/tasks.parquet                              task_index, indexed by the task's words
    meta/episodes/chunk-000/file-000.parquet        one row an episode, with its own statistics
    data/chunk-000/file-000.parquet                 one row a frame
    videos/observation.images.camera/chunk-000/file-000.mp4

Written down from LeRobot 0.6.1 (``lerobot/datasets``); several files a chunk are legal, so one file
an episode is.
"""

from __future__ import annotations

import re
from pathlib import Path
from typing import Any

from pydantic import BaseModel, ConfigDict, Field, ValidationError

from clothrf_core.errors import DataError
from clothrf_core.files import read_json

VERSION = "v3.0"
FILES_PER_CHUNK = 1000

INFO = "meta/info.json"
STATS = "meta/stats.json"
TASKS = "meta/tasks.parquet"
EPISODES_PATH = "meta/episodes/chunk-{chunk_index:03d}/file-{file_index:03d}.parquet"
DATA_PATH = "data/chunk-{chunk_index:03d}/file-{file_index:03d}.parquet"
VIDEO_PATH = "videos/{video_key}/chunk-{chunk_index:03d}/file-{file_index:03d}.mp4"

STATE = "observation.state"
FEATURES = "observation.environment_state"
ACTION = "action"
COLOUR = "observation.images.camera"
DEPTH = "observation.images.camera_depth"
COUNTERS = {
    "timestamp": "float32",
    "frame_index": "int64",
    "episode_index": "int64",
    "index": "int64",
    "task_index": "int64",
}


def place(episode: int) -> dict[str, int]:
    """Chunk and file of an episode, when every episode has files of its own."""
    chunk, file = divmod(episode, FILES_PER_CHUNK)
    return {"chunk_index": chunk, "file_index": file}


class FeatureInfo(BaseModel):
    """One entry of ``info.json``'s features."""

    model_config = ConfigDict(frozen=True, extra="ignore")

    dtype: str
    shape: tuple[int, ...]
    names: Any = None

    def flat_names(self, key: str) -> tuple[str, ...]:
        """A name for each number of the feature, made up where the file gives none."""
        count = 1
        for side in self.shape:
            count *= side
        names = self.names
        if isinstance(names, dict) and len(names) == 1:
            names = next(iter(names.values()))
        if isinstance(names, list) and len(names) == count:
            return tuple(map(str, names))
        return (key,) if count == 1 else tuple(f"{key}[{i}]" for i in range(count))


class Info(BaseModel):
    """What this package needs of ``info.json``; unknown keys are allowed, as LeRobot allows them.

    The path templates are not used: LeRobot itself reads every file below ``data``, and a template
    of a stranger should not choose which file is opened.
    """

    model_config = ConfigDict(frozen=True, extra="ignore")

    codebase_version: str
    fps: float = Field(gt=0.0, allow_inf_nan=False)
    features: dict[str, FeatureInfo]
    total_episodes: int = Field(ge=0)
    total_frames: int = Field(ge=0)
    robot_type: str | None = None


def read_info(folder: Path) -> Info:
    """The ``info.json`` of a LeRobotDataset.

    Raises:
        DataError: there is none, it is not JSON, of another version, or not as the format says.
    """
    path = folder / INFO
    if not path.exists():
        raise DataError(
            f"{folder}: expected a LeRobotDataset (with {INFO}), found none. "
            "Name the folder that holds meta/, data/ and perhaps videos/"
        )
    return parse_info(read_json(path), str(path))


def parse_info(value: object, where: str) -> Info:
    """`value`, the content of an ``info.json``, checked.

    Raises:
        DataError: another version, or not as the format says; every problem is named.
    """
    version = value.get("codebase_version") if isinstance(value, dict) else None
    if isinstance(version, str) and re.fullmatch(r"v?[012]\.\d+", version):
        raise DataError(
            f"{where}: expected codebase_version {VERSION}, found {version}. Convert it with "
            "LeRobot's lerobot.scripts.convert_dataset_v21_to_v30"
        )
    if isinstance(version, str) and not re.fullmatch(r"v?3\.\d+", version):
        raise DataError(
            f"{where}: expected codebase_version {VERSION}, found {version!r}. Update clothrf, "
            "or export the data as v3.0"
        )
    try:
        return Info.model_validate(value)
    except ValidationError as error:
        problems = "; ".join(
            f"{'.'.join(map(str, e['loc'])) or 'the file'}: {e['msg']}" for e in error.errors()
        )
        raise DataError(
            f"{where}: expected the info.json of a LeRobotDataset {VERSION}, found: {problems}"
        ) from error
