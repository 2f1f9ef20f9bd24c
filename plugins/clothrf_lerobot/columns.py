"""The columns of a roll-out, and the roll-out of columns: exact in both directions.

What LeRobot's own policies read comes first, as float32:

=============================  ===============================================================
observation.state              where the robot held the cloth, world metres
observation.environment_state  the features of the picture, bit for bit
action                         x* of the roll-out's own task: where the expert wants the grippers
=============================  ===============================================================

Everything else of a `Rollout` follows under ``clothrf.``, in its own type; LeRobot passes such
columns on and its policies ignore them.
"""

from __future__ import annotations

import json
from collections.abc import Mapping, Sequence
from typing import Any

import numpy as np
import pyarrow as pa
from numpy.typing import NDArray

from clothrf_core.dataset import ARRAYS, Rollout
from clothrf_core.errors import DataError
from clothrf_lerobot.layout import ACTION, COUNTERS, FEATURES, STATE

OURS = "clothrf."
KEY = b"clothrf"  # of the schema's metadata
FORMAT = 1
AXES = "xyz"

Columns = dict[str, NDArray[Any]]


def columns_of(rollout: Rollout) -> Columns:
    """(S, n) array of every column of `rollout` but the counters."""
    count = len(rollout)
    task = list(rollout.meta["tasks"]).index(rollout.meta["task"])
    found: Columns = {
        STATE: np.asarray(rollout.grasps, np.float32).reshape(count, -1),
        FEATURES: np.asarray(rollout.features),
        ACTION: np.asarray(rollout.labels[:, task], np.float32).reshape(count, -1),
    }
    for name in ARRAYS:
        if name != "features":
            found[OURS + name] = np.asarray(getattr(rollout, name)).reshape(count, -1)
    return found


def names_of(names: Sequence[str], tasks: Sequence[str], grippers: int) -> dict[str, list[str]]:
    """A name for every number of every column of `columns_of`."""

    def points(who: str, count: int) -> list[str]:
        return [f"{who}{i}.{axis}" for i in range(count) for axis in AXES]

    corners = points("gripper", grippers)
    named = {
        STATE: corners,
        FEATURES: list(names),
        ACTION: corners,
        OURS + "anchors": list(AXES),
        OURS + "labels": [f"{task}.{corner}" for task in tasks for corner in corners],
        OURS + "executed": corners,
        OURS + "grasps": corners,
        OURS + "hands": points("hand", 2),
    }
    flags = ("valid", "by_expert", "confidence", "feasible")
    return {**named, **{OURS + flag: [flag] for flag in flags}}


def counters_of(episode: int, first: int, count: int, task: int, fps: float) -> Columns:
    """The five columns that LeRobot itself adds, each (count, 1)."""
    frame = np.arange(count)
    values = {
        "timestamp": frame / fps,
        "frame_index": frame,
        "episode_index": np.full(count, episode),
        "index": first + frame,
        "task_index": np.full(count, task),
    }
    return {key: values[key].astype(dtype)[:, None] for key, dtype in COUNTERS.items()}


def features_of(columns: Columns, names: Mapping[str, Sequence[str]]) -> dict[str, Any]:
    """The entries of ``info.json`` for numeric columns."""
    return {
        key: {
            "dtype": str(values.dtype),
            "shape": [values.shape[1]],
            "names": list(names[key]) if key in names else None,
        }
        for key, values in columns.items()
    }


def table_of(columns: Columns) -> pa.Table:
    """An Arrow table; columns of one number are plain, others lists of fixed length."""
    arrays = {}
    for key, values in columns.items():
        flat, width = pa.array(np.ascontiguousarray(values).reshape(-1)), values.shape[1]
        arrays[key] = flat if width == 1 else pa.FixedSizeListArray.from_arrays(flat, width)
    return pa.table(arrays)


def with_header(table: pa.Table, header: Mapping[str, Any]) -> pa.Table:
    """`table` that says, beside its rows, what `header_of` reads."""
    text = json.dumps({"format": FORMAT, **header}, sort_keys=True)
    return table.replace_schema_metadata({KEY: text.encode()})


def header_of(schema: pa.Schema, where: str) -> dict[str, Any] | None:
    """What `with_header` was given; None if the file is not ours.

    Raises:
        DataError: it is ours, but of another format.
    """
    data = (schema.metadata or {}).get(KEY)
    if data is None:
        return None
    try:
        header = json.loads(data)
    except (UnicodeDecodeError, json.JSONDecodeError):
        header = None
    if not isinstance(header, dict) or header.pop("format", None) != FORMAT:
        raise DataError(f"{where}: expected clothrf columns of format {FORMAT}; update clothrf")
    return header


def matrix(column: pa.ChunkedArray, where: str) -> NDArray[Any]:
    """(S, n) numbers of one column, whatever lists they stand in.

    Raises:
        DataError: not numbers, gaps, or rows of different lengths.
    """
    parts = [_numbers(chunk, where) for chunk in column.chunks if len(chunk)]
    if len({part.shape[1] for part in parts}) > 1:
        raise DataError(f"{where}: expected rows of one length, found several")
    return np.concatenate(parts) if parts else np.zeros((0, 0))


def _numbers(array: pa.Array, where: str) -> NDArray[Any]:
    count = len(array)
    if isinstance(array, pa.ExtensionArray):
        array = array.storage
    gaps = array.null_count
    while isinstance(array, pa.ListArray | pa.LargeListArray | pa.FixedSizeListArray):
        lengths = array.drop_null().value_lengths().to_numpy(zero_copy_only=False)
        if len(np.unique(lengths)) > 1:
            raise DataError(f"{where}: expected rows of one length, found several")
        array = array.flatten()
        gaps += array.null_count
    if gaps:
        raise DataError(f"{where}: expected a number in every row, found {gaps} gaps")
    kind = array.type
    numeric = (pa.types.is_floating, pa.types.is_integer, pa.types.is_boolean)
    if not any(is_kind(kind) for is_kind in numeric):
        raise DataError(f"{where}: expected numbers, found {kind}; choose another column")
    values: NDArray[Any] = array.to_numpy(zero_copy_only=False).reshape(count, -1)
    return values


def rollout_of(columns: Columns, tasks: Sequence[str], meta: Mapping[str, Any]) -> Rollout:
    """The inverse of `columns_of`."""
    count = len(columns[FEATURES])
    shapes = {"anchors": (3,), "labels": (len(tasks), -1, 3), "hands": (2, 3)}
    arrays = {"features": columns[FEATURES]}
    for name in ARRAYS[1:]:
        values = columns[OURS + name]
        default = () if values.shape[1] == 1 else (-1, 3)
        arrays[name] = values.reshape(count, *shapes.get(name, default))
    return Rollout(**arrays, meta=dict(meta))
