"""The pictures of a run's report: what the camera saw, and a short film beside the expert's."""

from __future__ import annotations

import dataclasses
from collections.abc import Callable

from clothrf_core import compose, plots
from clothrf_core.config import Component, Resolved
from clothrf_core.registry import Registry
from clothrf_core.run_folder import RunFolder
from clothrf_core.show import beside, contact_sheet, film

STEPS, EVERY = 240, 3


def gallery(
    run: RunFolder,
    registry: Registry,
    on_plan: Callable[[int], None] = lambda _: None,
    on_done: Callable[[], None] = lambda: None,
) -> dict[str, tuple[bytes, str]]:
    """File name -> (bytes, caption) for every task of a finished run."""
    resolved = in_colour(run.resolved(registry))
    policy, _ = compose.open_policy(run.best, registry)
    shop = compose.workshop(resolved, registry)
    seed = resolved.experiment.run.seed
    on_plan(2 * len(resolved.task_names))
    pictures: dict[str, tuple[bytes, str]] = {}
    for task in resolved.task_names:
        films = []
        for actor in (policy, None):
            films.append(film(shop, actor, task, seed=seed, index=0, steps=STEPS, every=EVERY))
            on_done()
        pictures[f"{task}.png"] = (
            plots.picture_png(contact_sheet(films[0])),
            f"{task}: what the robot's camera sees (above) and the same instants from the side. "
            "Orange: where the expert wants the grippers; green: where the policy has them.",
        )
        period = EVERY / resolved.experiment.run.rate_hz
        pictures[f"{task}.gif"] = (
            plots.animation_gif(beside(films[0], films[1]), frame_s=period),
            f"{task}: the policy (left) and the expert who sees the true hands (right), "
            "same hand motion.",
        )
    return pictures


def in_colour(resolved: Resolved) -> Resolved:
    """The same experiment with a camera that also draws colour, if it can be told to."""
    chosen = resolved.components["camera"]
    if "colour" not in type(chosen.options).model_fields:
        return resolved
    options = chosen.options.model_copy(update={"colour": True})
    components = {**resolved.components, "camera": Component(chosen.kind, chosen.plugin, options)}
    return dataclasses.replace(resolved, components=components)
