"""Closed loop: the trained policy and its expert, alone, on the same random hand motions."""

from __future__ import annotations

from collections.abc import Callable
from typing import Any

import numpy as np

from clothrf_core.collection import collect, engine
from clothrf_core.errors import DataError
from clothrf_core.evaluation import EpisodeJob, interval
from clothrf_core.files import atomic_write, json_bytes
from clothrf_core.registry import Registry
from clothrf_core.run_folder import RunFolder


def closed_loop(
    run: RunFolder,
    registry: Registry,
    seeds: int | None = None,
    on_plan: Callable[[int], None] = lambda _: None,
    on_done: Callable[[], None] = lambda: None,
) -> list[dict[str, Any]]:
    """Mean grasp error of policy and expert for every task; written to ``evaluation.json``.

    Args:
        run: a finished run.
        registry: what is installed.
        seeds: episodes a controller and task; default: the config's.
        on_plan: told the number of episodes.
        on_done: told of every finished one.

    Raises:
        DataError: the run has no policy yet.
    """
    if not run.best.exists():
        raise DataError(f"{run.path}: has no policy yet; finish it: clothrf train --resume")
    resolved = run.resolved(registry)
    section = resolved.experiment.evaluation
    count = seeds or section.seeds
    controllers = {resolved.components["policy"].plugin: str(run.best), "expert": ""}
    jobs = [
        EpisodeJob(
            config=str(run.experiment),
            policy=folder,
            task=task,
            seed=resolved.experiment.run.seed,
            index=index,
            targets=section.targets,
            max_steps=section.max_steps,
        )
        for task in resolved.task_names
        for folder in controllers.values()
        for index in range(count)
    ]
    on_plan(len(jobs))
    workers = engine(resolved.experiment.collection)
    try:
        results = collect(jobs, workers, lambda _: on_done())
    finally:
        workers.close()
    table = []
    for i, (task, controller) in enumerate(
        (t, c) for t in resolved.task_names for c in controllers
    ):
        part = results[i * count : (i + 1) * count]
        mean, half = interval(np.array([r["mean_mm"] for r in part]))
        table.append(
            {
                "controller": controller,
                "task": task,
                "mean_mm": mean,
                "half_mm": half,
                "p95_mm": float(np.mean([r["p95_mm"] for r in part])),
                "steps": float(np.mean([r["steps"] for r in part])),
                "invalid": float(np.mean([r["invalid"] for r in part])),
                "seeds": count,
            }
        )
    atomic_write(run.path / "evaluation.json", json_bytes({"closed_loop": table}))
    return table
