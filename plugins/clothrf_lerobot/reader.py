"""A LeRobotDataset v3.0 as a data set to train on.

Ours comes back bit for bit, file by file. A stranger's columns are named by a `Mapping`: which are
the features, which the wanted grasp points, which say where the robot held the cloth.
"""

from __future__ import annotations

import re
from collections.abc import Iterator, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any

from clothrf_core.dataset import ARRAYS, Dataset, Rollout, write_rollout
from clothrf_core.errors import DataError
from clothrf_core.files import atomic_folder, names_digest
from clothrf_lerobot import layout
from clothrf_lerobot.columns import OURS, header_of, matrix, rollout_of
from clothrf_lerobot.foreign import Mapping, chosen_task, foreign_rollouts
from clothrf_lerobot.layout import FEATURES, Info
from clothrf_lerobot.parquet import read_schema, read_table

PLACE = re.compile(r"(iteration|heldout)_\d{3,6}/rollout_\d{4,7}\.npz")


@dataclass(frozen=True)
class Imported:
    """What an import made."""

    rollouts: int
    held_out: int
    rows: int
    tasks: tuple[str, ...]


def import_dataset(
    folder: Path,
    out: Path,
    *,
    columns: Sequence[str] = (),
    task: str | None = None,
    held_out: float = 0.1,
) -> Imported:
    """Make the data set `out` from the LeRobotDataset in `folder`; all of it or nothing.

    Args:
        folder: the LeRobotDataset.
        out: a new folder.
        columns: a stranger's columns, see `Mapping.with_options`; those that are not said are
            guessed by LeRobot's usual names.
        task: only a stranger's episodes of this task.
        held_out: share of a stranger's episodes that are never trained on.

    Raises:
        DataError: wrong version, missing columns, torn files, or `out` exists.
    """
    if out.exists():
        raise DataError(f"{out}: expected a new folder, found one; choose another")
    info = layout.read_info(folder)
    files = sorted(folder.glob("data/*/*.parquet"))
    headers = [header_of(read_schema(path), str(path)) for path in files]
    own = [header for header in headers if header is not None]
    if files and len(own) == len(files) and not columns and task is None:
        names = info.features[FEATURES].flat_names(FEATURES) if FEATURES in info.features else ()
        tasks = tuple(own[0]["meta"]["tasks"])
        rollouts = _ours(info, files, own, names, tasks)
    else:
        mapping = Mapping.guess(info).with_options(columns)
        names = mapping.feature_names(info)
        chosen = chosen_task(folder, task)
        tasks = (chosen[1],)
        rollouts = foreign_rollouts(info, files, mapping, names, chosen, held_out)
    counts, rows = {"heldout": 0, "iteration": 0}, 0
    with atomic_folder(out) as temporary:
        Dataset.create(temporary, names, tasks)
        for place, rollout in rollouts:
            write_rollout(temporary / place, rollout)
            counts[place.split("_")[0]] += 1
            rows += len(rollout)
        if not counts["iteration"]:
            raise DataError(
                f"{folder}: expected episodes to learn from, found {counts['heldout']} to test on; "
                "with --held-out 0 all are learned from"
            )
    return Imported(sum(counts.values()), counts["heldout"], rows, tasks)


def _ours(
    info: Info,
    files: Sequence[Path],
    headers: Sequence[dict[str, Any]],
    names: tuple[str, ...],
    tasks: tuple[str, ...],
) -> Iterator[tuple[str, Rollout]]:
    """(place, roll-out) of every episode that ``info.json`` counts."""
    if len(files) < info.total_episodes:
        raise DataError(
            f"{files[0].parent}: expected {info.total_episodes} episodes, found {len(files)}; "
            "copy or export the data set again"
        )
    rows = 0
    counted = list(zip(files, headers, strict=True))[: info.total_episodes]
    for path, header in counted:
        place, meta = str(header.get("path")), header.get("meta")
        if not PLACE.fullmatch(place) or not isinstance(meta, dict):
            raise DataError(f"{path}: expected the place of a roll-out, found '{place}'")
        if meta.get("names") != names_digest(names) or tuple(meta.get("tasks", ())) != tasks:
            raise DataError(f"{path}: has other features or tasks than {layout.INFO} says")
        wanted = [FEATURES, *(OURS + name for name in ARRAYS if name != "features")]
        table = read_table(path, wanted)
        values = {name: matrix(table[name], f"{path}, column '{name}'") for name in wanted}
        rollout = rollout_of(values, tasks, meta)
        rows += len(rollout)
        yield place, rollout
    if rows != info.total_frames:
        raise DataError(
            f"{files[0].parent}: expected {info.total_frames} frames, found {rows}; "
            "copy or export the data set again"
        )
