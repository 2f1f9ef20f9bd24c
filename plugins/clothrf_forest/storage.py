"""The policy file: arrays in `forest.npz`, everything else in `policy.json`; no pickle.

::

    folder/
        policy.json   format, version, names, tasks, settings, shapes, sha256 of the arrays
        forest.npz    nodes, roots, leaves, base, calibration, novelty

Equal models give equal bytes. Loading checks the digest, every shape and every index, so that a
file that is damaged, truncated, foreign or newer is refused and never half-read.
"""

from __future__ import annotations

import io
import zipfile
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray
from pydantic import ValidationError

from clothrf_core.errors import DataError
from clothrf_core.files import atomic_write, json_bytes, names_digest, npz_bytes, read_json, sha256
from clothrf_forest.confidence import BINS, Calibration
from clothrf_forest.config import ForestConfig
from clothrf_forest.curves import Curves
from clothrf_forest.model import Model
from clothrf_forest.novelty import Novelty
from clothrf_forest.projections import Projections
from clothrf_forest.ridge import Scaling
from clothrf_forest.trees import NODE, Trees

FORMAT = "clothrf-forest"
VERSION = 3
ARRAYS = "forest.npz"
ABOUT = "policy.json"


def save(model: Model, folder: Path) -> None:
    """Write `model` into an existing folder; the JSON, which makes it whole, comes last."""
    arrays = _arrays_of(model)
    data = npz_bytes(arrays)
    about = {
        "format": FORMAT,
        "version": VERSION,
        "plugin": "forest",
        "tasks": list(model.tasks),
        "num_grasps": model.num_grasps,
        "num_features": len(model.names),
        "names_digest": names_digest(model.names),
        "names": list(model.names),
        "config": dict(model.config),
        "num_leaves": model.trees.num_leaves,
        "arrays": {
            k: [v.dtype.str if v.dtype != NODE else "node", *v.shape] for k, v in arrays.items()
        },
        "arrays_sha256": sha256(data),
    }
    atomic_write(folder / ARRAYS, data)
    atomic_write(folder / ABOUT, json_bytes(about))


def load(folder: Path) -> Model:
    """The model that was saved in `folder`.

    Raises:
        DataError: the folder is corrupt, incomplete, or of another kind or a newer version.
    """
    folder = Path(folder)
    about = _about(folder)
    try:
        data = (folder / ARRAYS).read_bytes()
    except OSError as error:
        raise DataError(f"{folder}: the forest's arrays cannot be read ({error})") from error
    if sha256(data) != about.get("arrays_sha256"):
        raise DataError(
            f"{folder / ARRAYS}: not the {len(data)} bytes that {ABOUT} was written for; the file "
            "is damaged, truncated or of another policy. Copy the whole folder again"
        )
    try:
        with np.load(io.BytesIO(data), allow_pickle=False) as stored:
            arrays = {name: stored[name] for name in stored.files}
        model = _model_of(about, arrays)
    except (KeyError, TypeError, ValueError, OSError, zipfile.BadZipFile, ValidationError) as error:
        raise DataError(f"{folder}: not a whole forest policy ({error})") from error
    _check(model, folder)
    return model


def _about(folder: Path) -> dict[str, Any]:
    path = folder / ABOUT
    if not path.is_file():
        raise DataError(f"{folder}: no {ABOUT}; expected the folder of a saved policy")
    about = read_json(path)
    kind = about.get("format") if isinstance(about, dict) else None
    if kind != FORMAT:
        raise DataError(f"{path}: expected a policy of format '{FORMAT}', got '{kind}'")
    version = about.get("version")
    if version != VERSION:
        raise DataError(
            f"{path}: expected version {VERSION}, got {version}; it was written by another "
            "version of clothrf, load it with that one or train again"
        )
    result: dict[str, Any] = about
    return result


def _arrays_of(model: Model) -> dict[str, NDArray[Any]]:
    return {
        "nodes": model.trees.nodes,
        "roots": model.trees.roots,
        "values": model.values,
        "slopes": model.slopes,
        "variance": model.variance,
        "usual": model.usual,
        "centre": model.centre,
        "scale": model.scale,
        "curve_axes": model.curves.axes,
        "curve_offset": model.curves.offset,
        "curve_centre": model.curves.by.centre,
        "curve_scale": model.curves.by.scale,
        "coef": model.coef,
        "intercept": model.intercept,
        "projection_axes": model.projections.axes,
        "projection_offset": model.projections.offset,
        "novelty_mean": model.novelty.mean,
        "novelty_axes": model.novelty.axes,
        "novelty_precision": model.novelty.precision,
        "novelty_rest": np.array(model.novelty.rest),
        "novelty_limits": model.novelty.limits,
        "calibration_doubt": model.calibration.doubt,
        "calibration_share": model.calibration.share,
        "calibration_error": model.calibration.error,
    }


def _model_of(about: dict[str, Any], arrays: dict[str, NDArray[Any]]) -> Model:
    config = ForestConfig.model_validate(about["config"]).stored()
    return Model(
        names=tuple(str(name) for name in about["names"]),
        tasks=tuple(str(task) for task in about["tasks"]),
        num_grasps=int(about["num_grasps"]),
        config=config,
        trees=Trees(
            arrays["nodes"].astype(NODE, copy=False), arrays["roots"], int(about["num_leaves"])
        ),
        values=arrays["values"],
        slopes=arrays["slopes"],
        variance=arrays["variance"],
        usual=arrays["usual"],
        centre=arrays["centre"],
        scale=arrays["scale"],
        curves=Curves(
            arrays["curve_axes"],
            arrays["curve_offset"],
            Scaling(arrays["curve_centre"], arrays["curve_scale"]),
        ),
        coef=arrays["coef"],
        intercept=arrays["intercept"],
        projections=Projections(arrays["projection_axes"], arrays["projection_offset"]),
        novelty=Novelty(
            mean=arrays["novelty_mean"],
            axes=arrays["novelty_axes"],
            precision=arrays["novelty_precision"],
            rest=float(arrays["novelty_rest"]),
            limits=arrays["novelty_limits"],
        ),
        calibration=Calibration(
            doubt=arrays["calibration_doubt"],
            share=arrays["calibration_share"],
            error=arrays["calibration_error"],
        ),
    )


def _check(model: Model, folder: Path) -> None:
    """Refuse what would make acting read outside its arrays."""
    f = len(model.names) + (3 if model.config["use_anchor"] else 0)
    t, d = len(model.tasks), 3 * model.num_grasps
    leaves, m = model.trees.num_leaves, len(model.trees.nodes)
    k, h, q = len(model.novelty.mean), len(model.projections.offset), len(model.curves.offset)
    p = q * (q + 1) // 2
    s = h if model.slopes.ndim == 4 and model.slopes.shape[2] else 0
    wanted: dict[str, tuple[NDArray[Any], tuple[int, ...], type]] = {
        "values": (model.values, (t, leaves, d), np.float32),
        "slopes": (model.slopes, (t, leaves, s, d), np.float32),
        "variance": (model.variance, (t, leaves), np.float32),
        "usual": (model.usual, (leaves,), np.float32),
        "centre": (model.centre, (f,), np.float32),
        "scale": (model.scale, (f,), np.float32),
        "curve_axes": (model.curves.axes, (f, q), np.float32),
        "curve_centre": (model.curves.by.centre, (p,), np.float32),
        "curve_scale": (model.curves.by.scale, (p,), np.float32),
        "coef": (model.coef, (t, f + p, d), np.float32),
        "intercept": (model.intercept, (t, d), np.float64),
        "projection_axes": (model.projections.axes, (f, h), np.float32),
        "novelty_axes": (model.novelty.axes, (f, k), np.float32),
        "novelty_precision": (model.novelty.precision, (k,), np.float64),
        "novelty_limits": (model.novelty.limits, (2,), np.float64),
        "calibration_doubt": (model.calibration.doubt, (t, BINS), np.float64),
        "calibration_share": (model.calibration.share, (t, BINS), np.float64),
        "calibration_error": (model.calibration.error, (t, BINS), np.float64),
    }
    for name, (array, shape, dtype) in wanted.items():
        if array.shape != shape or array.dtype != dtype:
            raise DataError(
                f"{folder}: expected {name} of {np.dtype(dtype)} {shape}, got {array.dtype} "
                f"{array.shape}"
            )
    nodes, roots = model.trees.nodes, model.trees.roots
    inner = nodes["first"] >= 0
    child = nodes["child"].astype(np.int64)
    sound = (
        m > 0
        and roots.ndim == 1
        and len(roots) > 0
        and bool(((roots >= 0) & (roots < m)).all())
        and bool((nodes["first"] < f + h).all())
        and bool((nodes["second"] < f + h).all())
        # Children stand behind their parent, so every walk ends.
        and bool((child[inner] > np.flatnonzero(inner)).all())
        and bool((child[inner] + 1 < m).all())
        and bool(((child[~inner] >= 0) & (child[~inner] < leaves)).all())
    )
    if not sound:
        raise DataError(f"{folder}: the nodes of the forest point outside it; train again")
