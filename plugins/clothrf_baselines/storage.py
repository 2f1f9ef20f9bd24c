"""The policy file of a baseline: arrays in `baseline.npz`, everything else in `policy.json`.

::

    folder/
        policy.json    format, version, plugin, names, tasks, config, sha256 of the arrays
        baseline.npz   scaling, fall-back, and the arrays of the method

No pickle. Equal fits give equal bytes; damaged, truncated, foreign or newer files are refused.
"""

from __future__ import annotations

import io
import zipfile
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray
from pydantic import ValidationError

from clothrf_baselines.config import BaselineConfig
from clothrf_baselines.method import Arrays
from clothrf_core.errors import DataError
from clothrf_core.files import atomic_write, json_bytes, npz_bytes, read_json, sha256
from clothrf_core.types import Float, Float32

FORMAT = "clothrf-baseline"
VERSION = 1
ARRAYS = "baseline.npz"
ABOUT = "policy.json"

_OWN = ("columns", "x_mean", "x_scale", "y_mean", "y_scale", "fallback")


@dataclass(frozen=True, slots=True, eq=False)
class Fit:
    """A fitted baseline as arrays.

    Attributes:
        names: of all features it is given.
        tasks: T task names.
        num_grasps: G.
        columns: (c,) int32 features used.
        x_mean: (f,) float32; f = c, or c + 3 with the anchor.
        x_scale: (f,) float32.
        y_mean: (D,) float64, D = T G 3.
        y_scale: (D,) float64.
        fallback: (T, G, 3) float64 mean actions, world, m.
        arrays: what the method learnt.
    """

    names: tuple[str, ...]
    tasks: tuple[str, ...]
    num_grasps: int
    columns: NDArray[np.int32]
    x_mean: Float32
    x_scale: Float32
    y_mean: Float
    y_scale: Float
    fallback: Float
    arrays: Arrays


def save(fit: Fit, plugin: str, config: BaselineConfig, folder: Path) -> None:
    """Write `fit` into an existing folder; the JSON, which makes it whole, comes last."""
    arrays = {name: getattr(fit, name) for name in _OWN}
    arrays |= {f"method_{name}": array for name, array in fit.arrays.items()}
    data = npz_bytes(arrays)
    about = {
        "format": FORMAT,
        "version": VERSION,
        "plugin": plugin,
        "tasks": list(fit.tasks),
        "num_grasps": fit.num_grasps,
        "names": list(fit.names),
        # Threads do not shape the result.
        "config": config.model_dump(mode="json", exclude={"threads"}),
        "arrays": {name: [array.dtype.str, *array.shape] for name, array in arrays.items()},
        "arrays_sha256": sha256(data),
    }
    atomic_write(folder / ARRAYS, data)
    atomic_write(folder / ABOUT, json_bytes(about))


def load(plugin: str, config: type[BaselineConfig], folder: Path) -> tuple[Fit, Any]:
    """The fit and the config that were saved in `folder`.

    Raises:
        DataError: the folder is corrupt, incomplete, or of another kind or a newer version.
    """
    about = _about(plugin, folder)
    try:
        data = (folder / ARRAYS).read_bytes()
    except OSError as error:
        raise DataError(f"{folder}: the arrays of the policy cannot be read ({error})") from error
    if sha256(data) != about.get("arrays_sha256"):
        raise DataError(
            f"{folder / ARRAYS}: not the {len(data)} bytes that {ABOUT} was written for; the file "
            "is damaged, truncated or of another policy. Copy the whole folder again"
        )
    try:
        with np.load(io.BytesIO(data), allow_pickle=False) as stored:
            arrays = {name: stored[name] for name in stored.files}
        fit = Fit(
            names=tuple(str(name) for name in about["names"]),
            tasks=tuple(str(task) for task in about["tasks"]),
            num_grasps=int(about["num_grasps"]),
            arrays={
                name.removeprefix("method_"): array
                for name, array in arrays.items()
                if name.startswith("method_")
            },
            **{name: arrays[name] for name in _OWN},
        )
        options = config.model_validate(about["config"])
    except (KeyError, TypeError, ValueError, OSError, zipfile.BadZipFile, ValidationError) as error:
        raise DataError(f"{folder}: not a whole policy ({error})") from error
    _check(fit, options, folder)
    return fit, options


def _about(plugin: str, folder: Path) -> dict[str, Any]:
    path = folder / ABOUT
    if not path.is_file():
        raise DataError(f"{folder}: no {ABOUT}; expected the folder of a saved policy")
    about = read_json(path)
    kind = about.get("format") if isinstance(about, dict) else None
    if kind != FORMAT or about.get("plugin") != plugin:
        found = about.get("plugin", kind) if isinstance(about, dict) else kind
        raise DataError(f"{path}: expected a policy of plugin '{plugin}', got '{found}'")
    if about.get("version") != VERSION:
        raise DataError(
            f"{path}: expected version {VERSION}, got {about.get('version')}; it was written by "
            "another version of clothrf, load it with that one or train again"
        )
    result: dict[str, Any] = about
    return result


def _check(fit: Fit, config: BaselineConfig, folder: Path) -> None:
    """Refuse sizes that would make acting read outside its arrays."""
    inputs = len(fit.columns) + (3 if config.use_anchor else 0)
    outputs = len(fit.tasks) * fit.num_grasps * 3
    wanted = {
        "x_mean": (inputs,),
        "x_scale": (inputs,),
        "y_mean": (outputs,),
        "y_scale": (outputs,),
        "fallback": (len(fit.tasks), fit.num_grasps, 3),
    }
    for name, shape in wanted.items():
        found = getattr(fit, name).shape
        if found != shape:
            raise DataError(f"{folder}: expected {name} of shape {shape}, got {found}")
    columns = fit.columns
    if columns.ndim != 1 or columns.min(initial=0) < 0 or columns.max(initial=0) >= len(fit.names):
        raise DataError(f"{folder}: a feature is used that has no name; train again")
