"""The data set: one file a roll-out, written atomically, so that nothing is ever half there.

::

    dataset/
      dataset.json                    format, feature names, tasks
      iteration_001/rollout_0000.npz  arrays of `Rollout` + a JSON header
      iteration_001/rollout_0001.npz
      cache/                          column files of very large views; may be deleted
"""

from __future__ import annotations

import json
from collections.abc import Iterable, Mapping
from dataclasses import dataclass, fields
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from clothrf_core.arrays import checked
from clothrf_core.errors import DataError
from clothrf_core.files import (
    atomic_write,
    json_bytes,
    names_digest,
    npz_bytes,
    read_json,
    read_npz,
    read_npz_member,
)
from clothrf_core.types import DatasetView, Float, Float32, _set

FORMAT = 1
MEMORY_LIMIT_BYTES = 1 << 30  # larger views live in a memory-mapped column file


@dataclass(frozen=True, slots=True, eq=False)
class Rollout:
    """All rows of one roll-out of S steps.

    Attributes:
        features: (S, F) float32.
        valid: (S,) bool: the picture had a usable foreground.
        anchors: (S, 3) float64, world.
        labels: (S, T, G, 3) float64: raw x* of every task's expert, before limits.
        executed: (S, G, 3) float64: the limited targets that were really sent.
        grasps: (S, G, 3) float64: where the robot held the cloth when the picture was taken.
        hands: (S, 2, 3) float64: the truth, for analysis only.
        by_expert: (S,) bool: who acted.
        confidence: (S,) float64 of the acting policy; 1 for the expert.
        feasible: (S,) bool: the corners were within the cloth's reach.
        meta: JSON values: iteration, index, seed, task, tasks, names digest.
    """

    features: Float32
    valid: NDArray[np.bool_]
    anchors: Float
    labels: Float
    executed: Float
    grasps: Float
    hands: Float
    by_expert: NDArray[np.bool_]
    confidence: Float
    feasible: NDArray[np.bool_]
    meta: Mapping[str, Any]

    def __post_init__(self) -> None:
        s = len(self.features)
        shapes: dict[str, tuple[tuple[int | None, ...], Any]] = {
            "features": ((s, None), np.float32),
            "valid": ((s,), np.bool_),
            "anchors": ((s, 3), np.float64),
            "labels": ((s, None, None, 3), np.float64),
            "executed": ((s, None, 3), np.float64),
            "grasps": ((s, None, 3), np.float64),
            "hands": ((s, 2, 3), np.float64),
            "by_expert": ((s,), np.bool_),
            "confidence": ((s,), np.float64),
            "feasible": ((s,), np.bool_),
        }
        for name, (shape, dtype) in shapes.items():
            _set(self, **{name: checked(f"Rollout.{name}", getattr(self, name), shape, dtype)})

    def __len__(self) -> int:
        return len(self.features)


ARRAYS = tuple(f.name for f in fields(Rollout) if f.name != "meta")


def write_rollout(path: Path, rollout: Rollout) -> None:
    """Write one roll-out atomically; equal roll-outs give equal bytes."""
    header = json.dumps({"format": FORMAT, **rollout.meta}, sort_keys=True).encode()
    arrays = {name: np.asarray(getattr(rollout, name)) for name in ARRAYS}
    path.parent.mkdir(parents=True, exist_ok=True)
    atomic_write(path, npz_bytes({"header": np.frombuffer(header, np.uint8), **arrays}))


def read_rollout(path: Path) -> Rollout:
    """Read one roll-out.

    Raises:
        DataError: the file is damaged, foreign or of a newer format.
    """
    arrays = read_npz(path)
    missing = [name for name in ("header", *ARRAYS) if name not in arrays]
    if missing:
        raise DataError(f"{path}: expected a roll-out file, found none of: {', '.join(missing)}")
    try:
        meta = json.loads(arrays.pop("header").tobytes())
    except (UnicodeDecodeError, json.JSONDecodeError) as error:
        raise DataError(f"{path}: the header is not JSON ({error})") from error
    if meta.pop("format", None) != FORMAT:
        raise DataError(f"{path}: expected roll-out format {FORMAT}; update clothrf or the data")
    return Rollout(**{name: arrays[name] for name in ARRAYS}, meta=meta)


@dataclass(frozen=True)
class Dataset:
    """A folder of roll-outs with one feature layout and one list of tasks."""

    folder: Path
    names: tuple[str, ...]
    tasks: tuple[str, ...]

    @classmethod
    def create(cls, folder: Path, names: tuple[str, ...], tasks: tuple[str, ...]) -> Dataset:
        """Make or reopen a data set.

        Raises:
            DataError: the folder holds data of other features or tasks.
        """
        path = folder / "dataset.json"
        if path.exists():
            found = cls.open(folder)
            if found.names != names or found.tasks != tasks:
                raise DataError(
                    f"{folder}: holds {len(found.names)} features for {', '.join(found.tasks)}; "
                    f"expected {len(names)} for {', '.join(tasks)}. Choose another folder"
                )
            return found
        folder.mkdir(parents=True, exist_ok=True)
        header = {"format": FORMAT, "tasks": list(tasks), "names": list(names)}
        atomic_write(path, json_bytes(header))
        return cls(folder, names, tasks)

    @classmethod
    def open(cls, folder: Path) -> Dataset:
        """Open an existing data set.

        Raises:
            DataError: it is not a data set or is of another format.
        """
        header = read_json(folder / "dataset.json")
        if not isinstance(header, dict) or header.get("format") != FORMAT:
            raise DataError(f"{folder}: expected a data set of format {FORMAT}")
        return cls(folder, tuple(header["names"]), tuple(header["tasks"]))

    def path(self, iteration: int, index: int, *, kind: str = "iteration") -> Path:
        """Where roll-out `index` of `iteration` belongs."""
        return self.folder / f"{kind}_{iteration:03d}" / f"rollout_{index:04d}.npz"

    def paths(self, *, kind: str = "iteration", up_to: int | None = None) -> list[Path]:
        """Roll-out files in their one order: by iteration, then by index."""
        found = sorted(self.folder.glob(f"{kind}_*/rollout_*.npz"))
        if up_to is None:
            return found
        return [p for p in found if int(p.parent.name.rsplit("_", 1)[1]) <= up_to]

    def view(self, paths: Iterable[Path]) -> DatasetView:
        """The valid rows of some roll-outs, concatenated in the given order.

        Raises:
            DataError: a file is damaged or belongs to another data set.
        """
        digest = names_digest(self.names)
        files = list(paths)
        counts = [int(np.count_nonzero(read_npz_member(path, "valid"))) for path in files]
        total = sum(counts)
        if not total:
            raise DataError(f"{self.folder}: expected rows with a foreground, found none")
        features = self._column(total)
        other: dict[str, list[NDArray[Any]]] = {k: [] for k in ("anchors", "labels", "grasps")}
        start = 0
        for path, count in zip(files, counts, strict=True):
            rollout = read_rollout(path)
            if rollout.meta.get("names") != digest:
                raise DataError(f"{path}: was recorded with other features than {self.folder}")
            keep = np.asarray(rollout.valid)
            features[start : start + count] = rollout.features[keep]
            for name, column in other.items():
                column.append(getattr(rollout, name)[keep])
            start += count
        return DatasetView(
            features=features,
            names=self.names,
            anchors=np.concatenate(other["anchors"]),
            labels=np.concatenate(other["labels"]),
            tasks=self.tasks,
            groups=np.repeat(np.arange(len(files)), counts),
            grasps=np.concatenate(other["grasps"]),
        )

    def _column(self, count: int) -> Float32:
        """(count, F) float32 in memory, or in a memory-mapped file when it would be large."""
        shape = (count, len(self.names))
        if 4 * count * len(self.names) <= MEMORY_LIMIT_BYTES:
            return np.empty(shape, np.float32)
        cache = self.folder / "cache"
        cache.mkdir(exist_ok=True)
        column: Float32 = np.lib.format.open_memmap(
            cache / "features.npy", mode="w+", dtype=np.float32, shape=shape
        )
        return column
