"""A LeRobotDataset v3.0 that is whole at every moment.

One data file, one film and one metadata file an episode, each written aside, made durable and
renamed; then statistics and tasks; the counts of ``info.json`` last. Killed at any instant, the
folder opens with every episode that was finished, and running the same export again goes on there.
"""

from __future__ import annotations

from collections.abc import Callable, Mapping
from dataclasses import dataclass
from pathlib import Path
from typing import TYPE_CHECKING, Any

import pyarrow as pa

from clothrf_core.dataset import Rollout
from clothrf_core.errors import DataError
from clothrf_core.files import atomic_write, json_bytes
from clothrf_core.registry import Registry
from clothrf_lerobot import layout, stats
from clothrf_lerobot.columns import (
    Columns,
    columns_of,
    counters_of,
    features_of,
    header_of,
    names_of,
    table_of,
    with_header,
)
from clothrf_lerobot.parquet import parquet_bytes, read_schema, read_table, tasks_table
from clothrf_lerobot.source import Source

if TYPE_CHECKING:  # av is needed only for pictures
    from clothrf_lerobot.pictures import Pictures, Replays

FOLDERS = {"meta", "data", "videos"}


@dataclass(frozen=True)
class Episode:
    """One roll-out on its way into the data set.

    Attributes:
        index: its number.
        first: number of its first frame in the whole data set.
        rollout: its arrays.
        header: what its files say about where they are from; equal headers, equal files.
    """

    index: int
    first: int
    rollout: Rollout
    header: Mapping[str, Any]


def export(
    source: Source,
    registry: Registry,
    out: Path,
    *,
    pictures: bool = False,
    on_episode: Callable[[], None] = lambda: None,
) -> int:
    """Write all roll-outs of `source` below `out`; returns how many were not there already.

    Raises:
        DataError: `out` holds something else, or a roll-out is damaged or cannot be drawn again.
        StorageFull: everything finished before is intact.
    """
    _check_target(out, len(source.paths))
    replays: Replays | None = None
    if pictures:
        from clothrf_lerobot.pictures import replays_of

        replays = replays_of(source, registry)
    whole = _Whole(source, out, {} if replays is None else replays.features(source.fps))
    written = 0
    for index, (name, rollout, digest) in enumerate(source.rollouts()):
        header = {
            "path": name,
            "source": digest,
            "meta": dict(rollout.meta),
            "fps": source.fps,
            "first": whole.frames,
            "pictures": pictures,
        }
        episode = Episode(index, whole.frames, rollout, header)
        own = _finished(out, episode)
        if own is None:
            whole.promise()
            drawn = None if replays is None else replays.draw(name, rollout, source.fps)
            own = _write(source, out, episode, drawn)
            written += 1
        whole.add(episode, own)
        if whole.promised < whole.episodes:
            whole.promise()
        on_episode()
    return written


def _check_target(out: Path, episodes: int) -> None:
    """Only a new folder, or one of an earlier export, is written into."""
    if not out.exists():
        return
    strangers = [p.name for p in out.iterdir() if p.name not in FOLDERS and p.name[0] != "."]
    files = sorted(out.glob("data/*/*.parquet"))
    strangers += [p.name for p in files if header_of(read_schema(p), str(p)) is None]
    if not out.is_dir() or strangers or ((out / layout.INFO).exists() and not files):
        raise DataError(
            f"{out}: expected a new folder or one of an earlier export, found "
            f"{', '.join(strangers[:3]) or 'another data set'}; choose another"
        )
    if len(files) > episodes:
        raise DataError(
            f"{out}: expected an earlier export of at most {episodes} episodes, found one of "
            f"{len(files)}; choose another folder"
        )
    for left in out.rglob(".*.tmp"):  # of a killed export
        left.unlink()


def _finished(out: Path, episode: Episode) -> stats.Stats | None:
    """The statistics of an episode that an earlier export finished from the same roll-out."""
    place = layout.place(episode.index)
    path = out / layout.EPISODES_PATH.format(**place)
    needed = [path, out / layout.DATA_PATH.format(**place)]
    if episode.header["pictures"]:
        needed.append(out / layout.VIDEO_PATH.format(video_key=layout.COLOUR, **place))
    if not all(p.exists() for p in needed):
        return None
    if header_of(read_schema(path), str(path)) != episode.header:
        return None
    [row] = read_table(path).to_pylist()
    found: dict[str, dict[str, Any]] = {}
    for key, value in row.items():
        if key.startswith("stats/"):
            _, column, name = key.split("/")
            found.setdefault(column, {})[name] = value
    return stats.from_nested(found)


def _write(source: Source, out: Path, episode: Episode, drawn: Pictures | None) -> stats.Stats:
    """All files of one episode; its row of metadata, which says that it is whole, comes last."""
    rollout, place = episode.rollout, layout.place(episode.index)
    columns = _columns(source, episode)
    own = stats.episode_stats(columns)
    table = table_of(columns)
    if drawn is not None:
        own.update(drawn.stats)
        depths = [{"bytes": png, "path": None} for png in drawn.depths]
        kind = pa.struct([("bytes", pa.binary()), ("path", pa.string())])
        table = table.append_column(layout.DEPTH, pa.array(depths, kind))
        _put(out / layout.VIDEO_PATH.format(video_key=layout.COLOUR, **place), drawn.film)
    _put(out / layout.DATA_PATH.format(**place), parquet_bytes(with_header(table, episode.header)))
    row: dict[str, Any] = {
        "episode_index": episode.index,
        "tasks": [rollout.meta["task"]],
        "length": len(rollout),
        "data/chunk_index": place["chunk_index"],
        "data/file_index": place["file_index"],
        "dataset_from_index": episode.first,
        "dataset_to_index": episode.first + len(rollout),
        "meta/episodes/chunk_index": place["chunk_index"],
        "meta/episodes/file_index": place["file_index"],
    }
    if drawn is not None:
        film = f"videos/{layout.COLOUR}"
        row |= {f"{film}/{name}": value for name, value in place.items()}
        row |= {f"{film}/from_timestamp": 0.0, f"{film}/to_timestamp": len(rollout) / source.fps}
    for key, values in stats.nested(own).items():
        row |= {f"stats/{key}/{name}": value for name, value in values.items()}
    described = with_header(pa.Table.from_pylist([row]), episode.header)
    _put(out / layout.EPISODES_PATH.format(**place), parquet_bytes(described))
    return own


def _columns(source: Source, episode: Episode) -> Columns:
    rollout = episode.rollout
    task = source.dataset.tasks.index(rollout.meta["task"])
    counters = counters_of(episode.index, episode.first, len(rollout), task, source.fps)
    return {**columns_of(rollout), **counters}


class _Whole:
    """What the data set holds, and what its ``info.json`` promises to hold."""

    def __init__(self, source: Source, out: Path, pictured: Mapping[str, Any]) -> None:
        self._source, self._out, self._pictured = source, out, pictured
        self._features: dict[str, Any] = {}
        self._stats: stats.Stats = {}
        self.episodes = self.frames = 0
        path = out / layout.INFO
        self.promised = layout.read_info(out).total_episodes if path.exists() else 0

    def add(self, episode: Episode, own: stats.Stats) -> None:
        """One more episode is finished."""
        self.episodes, self.frames = self.episodes + 1, self.frames + len(episode.rollout)
        self._stats = stats.combined([self._stats, own] if self._stats else [own])
        if not self._features:
            source, grippers = self._source.dataset, episode.rollout.grasps.shape[1]
            names = names_of(source.names, source.tasks, grippers)
            plain = features_of(_columns(self._source, episode), names)
            self._features = {**plain, **self._pictured}

    def promise(self) -> None:
        """Let ``info.json`` count the episodes that are finished, no more and no fewer."""
        if self.promised == self.episodes:
            return
        self.promised = self.episodes
        if not self.episodes:  # the first is about to be replaced
            (self._out / layout.INFO).unlink()
            return
        tasks, fps = self._source.dataset.tasks, self._source.fps
        held_out = min(self._source.held_out, self.episodes)
        splits = {"heldout": f"0:{held_out}"} if held_out else {}
        if self.episodes > held_out:
            splits["train"] = f"{held_out}:{self.episodes}"
        info = {
            "codebase_version": layout.VERSION,
            "robot_type": "clothrf",
            "total_episodes": self.episodes,
            "total_frames": self.frames,
            "total_tasks": len(tasks),
            "chunks_size": layout.FILES_PER_CHUNK,
            "data_files_size_in_mb": 100,
            "video_files_size_in_mb": 200,
            "fps": int(fps) if fps.is_integer() else fps,
            "splits": splits,
            "data_path": layout.DATA_PATH,
            "video_path": layout.VIDEO_PATH if self._pictured else None,
            "features": self._features,
        }
        _put(self._out / layout.STATS, json_bytes(stats.nested(self._stats)))
        _put(self._out / layout.TASKS, parquet_bytes(tasks_table(tasks)))
        _put(self._out / layout.INFO, json_bytes(info))


def _put(path: Path, data: bytes) -> None:
    path.parent.mkdir(parents=True, exist_ok=True)
    atomic_write(path, data)
