"""A trained policy over real frames: grasp targets as a table and drawn on the pictures."""

from __future__ import annotations

import csv
import io
from collections.abc import Callable, Sequence
from dataclasses import dataclass
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from clothrf_core import compose
from clothrf_core.camera_model import project
from clothrf_core.errors import StaleFrame
from clothrf_core.files import atomic_write
from clothrf_core.interfaces import Camera, FeatureExtractor, Policy
from clothrf_core.loop import decide
from clothrf_core.plots import picture_png
from clothrf_core.provider import BuildContext
from clothrf_core.registry import Registry
from clothrf_core.rig import Rig
from clothrf_core.show import mark
from clothrf_core.types import Action, Features, Float, GraspState, Observation, RgbdFrame

UNMEASURED = np.full((2, 3), np.nan)
TARGET, ANCHOR, REFUSED = (242, 140, 40), (80, 160, 255), (220, 60, 60)


@dataclass(frozen=True, slots=True)
class Prediction:
    """What the policy says about one frame.

    Attributes:
        frame: the picture.
        name: its file name or number.
        features: what was read off it.
        actions: one a task.
    """

    frame: RgbdFrame
    name: str
    features: Features
    actions: tuple[tuple[str, Action], ...]


def predict(
    policy: Policy,
    extractor: FeatureExtractor,
    camera: Camera,
    grasp: Float,
    tasks: Sequence[str],
    on_frame: Callable[[Prediction], None],
) -> int:
    """Run the policy over every frame of `camera`; returns how many there were.

    Args:
        policy: a fitted policy.
        extractor: the features it was trained on.
        camera: opened by the caller; ends with `StaleFrame`.
        grasp: (2, 3) where the robot holds the cloth, world, m; NaN = nobody measured it, and the
            features look for the grippers in the picture.
        tasks: whose targets to predict.
        on_frame: gets each result as it is made.
    """
    names = getattr(camera, "names", ())
    count = 0
    while True:
        try:
            frame = camera.read()
        except StaleFrame:
            return count
        state = GraspState(grasp, frame.stamp_ns)
        features = extractor.extract(Observation(frame, state))
        actions = tuple((task, decide(policy, features, task, state)) for task in tasks)
        name = str(names[count]) if count < len(names) else f"{count:06d}"
        on_frame(Prediction(frame, name, features, actions))
        count += 1


def predict_folder(
    policy_folder: Path,
    pictures: Path,
    out: Path,
    registry: Registry,
    *,
    tasks: Sequence[str] = (),
    rig: Rig | None = None,
    overlays: bool = True,
    on_frame: Callable[[Prediction], None] = lambda _: None,
) -> int:
    """Write ``predictions.csv`` and ``overlay_*.png`` for a folder of pictures into `out`.

    Args:
        policy_folder: a saved policy.
        pictures: colour + 16-bit depth pictures and their camera file (the "folder" camera).
        out: folder to write into; made if needed.
        registry: what is installed.
        tasks: default: all tasks of the policy.
        rig: another rig than the one of training (its foreground cues and rest corners).
        overlays: also draw the targets on the pictures.
        on_frame: told of every frame.
    """
    policy, resolved = compose.open_policy(policy_folder, registry)
    rig = rig or resolved.rig
    context = BuildContext(rig=rig, registry=registry)
    chosen = resolved.components["features"]
    extractor = registry.build("features", chosen.plugin, chosen.options, context)
    provider = registry.find("camera", "folder")
    options = provider.config.model_validate({"path": pictures.absolute()})
    out.mkdir(parents=True, exist_ok=True)
    rows: list[list[object]] = []

    def keep(prediction: Prediction) -> None:
        rows.extend(table_rows(prediction))
        if overlays:
            data = picture_png(overlay(prediction))
            atomic_write(out / f"overlay_{prediction.name}.png", data)
        on_frame(prediction)

    with registry.build("camera", "folder", options, context) as camera:
        count = predict(policy, extractor, camera, UNMEASURED, tasks or policy.tasks, keep)
    atomic_write(out / "predictions.csv", csv_bytes(rows))
    return count


COLUMNS = (
    "frame", "stamp_ns", "task", "valid", "confidence", "anchor_x", "anchor_y", "anchor_z",
    "target0_x", "target0_y", "target0_z", "target1_x", "target1_y", "target1_z",
)  # fmt: skip


def table_rows(prediction: Prediction) -> list[list[object]]:
    """One row a task, in the order of `COLUMNS`; metres, world; empty targets if not valid."""
    features = prediction.features
    rows: list[list[object]] = []
    for task, action in prediction.actions:
        numbers = (
            [f"{x:.6f}" for x in (*features.anchor, *action.targets.ravel())]
            if features.valid
            else [""] * 9
        )
        rows.append(
            [
                prediction.name,
                prediction.frame.stamp_ns,
                task,
                str(features.valid).lower(),
                f"{action.confidence:.4f}",
                *numbers,
            ]
        )
    return rows


def csv_bytes(rows: Sequence[Sequence[object]]) -> bytes:
    """The table with its header line, as UTF-8."""
    text = io.StringIO()
    writer = csv.writer(text, lineterminator="\n")
    writer.writerow(COLUMNS)
    writer.writerows(rows)
    return text.getvalue().encode()


def overlay(prediction: Prediction) -> NDArray[np.uint8]:
    """The picture with anchor (blue) and targets (orange); a red border if nothing was seen."""
    image = np.array(prediction.frame.rgb)
    if not prediction.features.valid:
        image[:4], image[-4:], image[:, :4], image[:, -4:] = (REFUSED,) * 4
        return image
    camera = prediction.frame.camera
    mark(image, project(camera, prediction.features.anchor[None])[0], ANCHOR, size=8)
    for _, action in prediction.actions:
        mark(image, project(camera, np.asarray(action.targets))[0], TARGET, size=10)
    return image
