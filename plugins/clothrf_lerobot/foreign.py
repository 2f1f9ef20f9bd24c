"""Somebody else's columns as roll-outs: which are features, wanted and held grasp points."""

from __future__ import annotations

import re
from collections.abc import Iterator, Sequence
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Any

import numpy as np
import pyarrow as pa
from numpy.typing import NDArray

from clothrf_core.dataset import Rollout
from clothrf_core.errors import DataError, suggestion
from clothrf_core.files import names_digest
from clothrf_lerobot import layout
from clothrf_lerobot.columns import matrix
from clothrf_lerobot.layout import ACTION, COUNTERS, FEATURES, STATE, Info
from clothrf_lerobot.parquet import read_table

PART = re.compile(r"([^\[\]]+)(?:\[(\d+):(\d+)\])?")


@dataclass(frozen=True)
class Part:
    """Some numbers of one column, written ``column`` or ``column[first:stop]``."""

    column: str
    first: int = 0
    stop: int | None = None

    @classmethod
    def parse(cls, text: str) -> Part:
        """Read one.

        Raises:
            DataError: it is not written like that.
        """
        match = PART.fullmatch(text.strip())
        if match is None:
            raise DataError(f"--map: expected column or column[first:stop], found '{text}'")
        column, first, stop = match.groups()
        return cls(column, int(first or 0), None if stop is None else int(stop))

    def of(self, table: pa.Table, where: str) -> NDArray[Any]:
        """(S, n) its numbers."""
        return matrix(table[self.column], f"{where}, column '{self.column}'")[:, self.slice]

    def names(self, info: Info) -> tuple[str, ...]:
        """A name for each of its numbers.

        Raises:
            DataError: the data set has no such column.
        """
        if self.column not in info.features:
            raise DataError(
                f"expected a column '{self.column}', found none. "
                f"{suggestion(self.column, info.features)}. Name it with --map"
            )
        return info.features[self.column].flat_names(self.column)[self.slice]

    @property
    def slice(self) -> slice:
        """Which of the column's numbers."""
        return slice(self.first, self.stop)


@dataclass(frozen=True)
class Mapping:
    """Which columns are what.

    Attributes:
        features: what a policy sees; several parts are joined.
        labels: the wanted grasp points, (x, y, z) of each gripper in world metres.
        grasps: where the robot held the cloth, likewise.
        anchors: (x, y, z) that labels are learned relative to; None = the world's origin.
    """

    features: tuple[Part, ...]
    labels: Part
    grasps: Part
    anchors: Part | None = None

    @classmethod
    def guess(cls, info: Info) -> Mapping:
        """By LeRobot's usual names."""
        seen = FEATURES if FEATURES in info.features else STATE
        return cls((Part(seen),), Part(ACTION), Part(STATE))

    def with_options(self, options: Sequence[str]) -> Mapping:
        """As said on the command line: ``features=a,b[0:3]``, ``labels=...`` and so on.

        Raises:
            DataError: an unknown name, or no columns.
        """
        changed: dict[str, Any] = {}
        for option in options:
            name, _, text = option.partition("=")
            roles = ("features", "labels", "grasps", "anchors")
            if name not in roles or not text:
                raise DataError(
                    f"--map: expected role=column, found '{option}'. {suggestion(name, roles)}"
                )
            parts = tuple(map(Part.parse, text.split(",")))
            if name != "features" and len(parts) > 1:
                raise DataError(f"--map {name}: expected one column, found {len(parts)}")
            changed[name] = parts if name == "features" else parts[0]
        return replace(self, **changed)

    @property
    def columns(self) -> list[str]:
        """All columns that are read."""
        parts = [*self.features, self.labels, self.grasps]
        return list(dict.fromkeys(p.column for p in [*parts, *filter(None, [self.anchors])]))

    def feature_names(self, info: Info) -> tuple[str, ...]:
        """Names of the features; with their column in front where two would be the same.

        Raises:
            DataError: a column is missing, or points are not three numbers each.
        """
        pairs = [(part.column, name) for part in self.features for name in part.names(info)]
        plain = [name for _, name in pairs]
        if len(set(plain)) < len(plain):
            plain = [f"{column}.{name}" for column, name in pairs]
        wanted = {"labels": (self.labels, 6), "grasps": (self.grasps, 6)}
        if self.anchors is not None:
            wanted["anchors"] = (self.anchors, 3)
        for role, (part, count) in wanted.items():
            found = len(part.names(info))
            if found != count:
                raise DataError(
                    f"column '{part.column}' as {role}: expected {count} numbers (x, y, z of "
                    f"{count // 3} points, world metres), found {found}. Choose others with "
                    f"--map {role}=column[first:stop]"
                )
        return tuple(plain)

    def rollout(self, table: pa.Table, where: str, meta: dict[str, Any]) -> Rollout:
        """One episode; hands are not known and are NaN."""
        features = np.concatenate([p.of(table, where) for p in self.features], axis=1)
        count = len(features)
        labels = self.labels.of(table, where).astype(np.float64).reshape(count, 1, 2, 3)
        anchors = np.zeros((count, 3))
        if self.anchors is not None:
            anchors = self.anchors.of(table, where).astype(np.float64)
        features = features.astype(np.float32)
        return Rollout(
            features=features,
            valid=np.isfinite(features).all(axis=1) & np.isfinite(labels).all(axis=(1, 2, 3)),
            anchors=anchors,
            labels=labels,
            executed=labels[:, 0],
            grasps=self.grasps.of(table, where).astype(np.float64).reshape(count, 2, 3),
            hands=np.full((count, 2, 3), np.nan),
            by_expert=np.ones(count, bool),
            confidence=np.ones(count),
            feasible=np.ones(count, bool),
            meta=meta,
        )


def foreign_rollouts(
    info: Info,
    files: Sequence[Path],
    mapping: Mapping,
    names: tuple[str, ...],
    task: tuple[int, str],
    share: float,
) -> Iterator[tuple[str, Rollout]]:
    """(place in the data set, roll-out) of every episode of one task.

    The first of every ``1 / share`` episodes is held out.
    """
    every = round(1.0 / share) if share > 0.0 else 0
    counts = {"iteration_001": 0, "heldout_000": 0}
    columns = [*mapping.columns, *(c for c in COUNTERS if c not in mapping.columns)]
    for path in files:
        table = read_table(path, columns)
        episodes = table["episode_index"].to_numpy()
        starts = np.flatnonzero(np.diff(episodes, prepend=-1))
        for start, stop in zip(starts, [*starts[1:], len(episodes)], strict=True):
            rows = table.slice(start, stop - start)
            own = episodes[start] < info.total_episodes and rows["task_index"][0].as_py() == task[0]
            if not own:
                continue
            number = sum(counts.values())
            kind = "heldout_000" if every and number % every == 0 else "iteration_001"
            index = counts[kind]
            counts[kind] += 1
            meta = {
                "kind": kind.split("_")[0],
                "iteration": int(kind[-3:]),
                "index": index,
                "seed": 0,
                "task": task[1],
                "tasks": [task[1]],
                "names": names_digest(names),
                "beta": 1.0,
            }
            yield f"{kind}/rollout_{index:04d}.npz", mapping.rollout(rows, str(path), meta)


def chosen_task(folder: Path, wanted: str | None) -> tuple[int, str]:
    """Number and words of the task to import.

    Raises:
        DataError: there are several and none was named, or not that one.
    """
    path = folder / layout.TASKS
    table = read_table(path)
    words = [c for c in table.column_names if c != "task_index"]
    if "task_index" not in table.column_names or len(words) != 1 or not len(table):
        raise DataError(f"{path}: expected the columns task_index and task, found others")
    tasks = dict(zip(table[words[0]].to_pylist(), table["task_index"].to_pylist(), strict=True))
    if wanted is None and len(tasks) == 1:
        [wanted] = tasks
    if wanted is None:
        raise DataError(
            f"{folder}: expected one task, found {len(tasks)}: {', '.join(map(str, tasks))}. "
            "Its rows say what one task wants, not all: choose one with --task"
        )
    if wanted not in tasks:
        raise DataError(f"{folder}: no task '{wanted}'. {suggestion(wanted, map(str, tasks))}")
    return tasks[wanted], wanted
