"""Measurements of the spine: collection, the paper's schedule, held-out error, resumption.

They run what a user runs (shipped configs, the command line) and name no plugin.
"""

from __future__ import annotations

import dataclasses
import os
import random
import signal
import subprocess
import sys
import tempfile
import time
from pathlib import Path
from typing import Any

import numpy as np

from clothrf_core import closed_loop, compose, config, imitation
from clothrf_core.collection import collect, engine
from clothrf_core.dataset import Dataset
from clothrf_core.evaluation import held_out
from clothrf_core.files import sha256
from clothrf_core.locations import shipped
from clothrf_core.provider import Figure
from clothrf_core.registry import Registry
from clothrf_core.rollout import RolloutJob
from clothrf_core.run_folder import RunFolder

KILL_SETTINGS = {
    "training.iterations": 3,
    "training.rollouts": 3,
    "training.steps": 12,
    "evaluation.rollouts": 2,
    "evaluation.steps": 10,
}


class Quiet:
    """Progress that nobody sees."""

    def advance(self, what: str) -> None:
        """Nothing."""

    def finished(self, record: dict[str, Any]) -> None:
        """Nothing."""


def collection(quick: bool) -> list[Figure]:  # noqa: FBT001
    """Samples a second on two workers: physics, picture, features, all experts."""
    rollouts = 8 if quick else 40
    registry = Registry.installed()
    with tempfile.TemporaryDirectory() as folder:
        path, names = resolved_file(Path(folder), "three_tasks.toml", {}, registry)
        jobs = [job(path, Path(folder) / f"{i}.npz", i, names) for i in range(rollouts + 2)]
        workers = engine(config.load(path, registry).experiment.collection)
        try:
            collect(jobs[:2], workers)  # workers start and compile outside the measurement
            start = time.perf_counter()
            collect(jobs[2:], workers)
            seconds = time.perf_counter() - start
        finally:
            workers.close()
        alone = _alone(path, Path(folder), names)
    samples = rollouts * jobs[0].steps
    detail = {
        "workers": 2,
        "samples": samples,
        "seconds": seconds,
        "cpu_ms_per_sample": 1e3 * alone,
    }
    return [Figure("collect_samples_per_s", samples / seconds, "1/s", detail)]


def schedule(quick: bool) -> list[Figure]:  # noqa: FBT001
    """The paper's schedule on the straight task, and what the policy is worth on unseen rollouts.

    The test roll-outs are neither trained on nor used to choose the best iteration.
    """
    changes: dict[str, Any] = {"training.iterations": 4} if quick else {}
    figures, detail = _schedule("straight.toml", changes, quick=quick)
    literal, _ = _schedule("paper_straight.toml", changes, quick=quick)
    rms, nre, seconds = figures
    return [
        Figure("paper_schedule_s", seconds, "s", detail),
        Figure("straight_rms_mm", rms, "mm", {"paper_literal_mm": literal[0], **detail}),
        Figure("straight_nre", nre, "1", {"paper_literal": literal[1]}),
    ]


def _schedule(
    name: str, changes: dict[str, Any], *, quick: bool
) -> tuple[tuple[float, float, float], dict[str, Any]]:
    registry = Registry.installed()
    with tempfile.TemporaryDirectory() as folder:
        resolved = config.load(shipped(name), registry, changes)
        run = RunFolder.start(Path(folder) / "run", resolved, resume=False)
        start = time.perf_counter()
        records = imitation.dagger(run, registry, Quiet())
        seconds = time.perf_counter() - start
        numbers = unseen_error(run, registry, rollouts=6 if quick else 40)
        table = closed_loop.closed_loop(run, registry, 2 if quick else None)
    detail: dict[str, Any] = {"samples": records[-1]["samples"], "best": imitation.best(records)}
    for row in table:
        half = f"{row['half_mm']:.1f}"
        detail[f"closed_loop_{row['controller']}_mm"] = f"{row['mean_mm']:.1f} ± {half}"
    return (numbers["rms_mm"], numbers["nre"], seconds), detail


def unseen_error(run: RunFolder, registry: Registry, *, rollouts: int) -> dict[str, Any]:
    """Held-out error of the best policy on roll-outs that played no part in training."""
    resolved = run.resolved(registry)
    policy, _ = compose.open_policy(run.best, registry)
    names = compose.extractor(resolved, registry).names
    data = Dataset.create(run.path / "test", names, resolved.task_names)
    jobs = imitation.held_out_jobs(run, resolved, data)
    fresh = [
        dataclasses.replace(
            jobs[i % 2], iteration=1, index=i, out=str(data.path(1, i, kind="heldout"))
        )
        for i in range(rollouts)
    ]
    workers = engine(resolved.experiment.collection)
    try:
        collect(fresh, workers)
    finally:
        workers.close()
    return held_out(policy, data.view(data.paths(kind="heldout")))


def resumption(quick: bool) -> list[Figure]:  # noqa: FBT001
    """SIGKILL a training run at random moments, resume it, compare the policy bit by bit."""
    trials = 5 if quick else 50
    moments = random.Random(0)
    with tempfile.TemporaryDirectory() as folder:
        base = Path(folder)
        start = time.perf_counter()
        _train(base / "whole").wait()
        whole = time.perf_counter() - start
        wanted = policy_digest(base / "whole")
        same = 0
        for trial in range(trials):
            out = base / f"killed{trial}"
            process = _train(out)
            time.sleep(moments.uniform(0.0, whole))
            if process.poll() is None:
                os.killpg(process.pid, signal.SIGKILL)
            process.wait()
            resume = _train(out, resume=(out / "experiment.toml").exists())
            same += resume.wait() == 0 and policy_digest(out) == wanted
        one = _train(base / "one_worker", workers=1)
        workers_same = one.wait() == 0 and policy_digest(base / "one_worker") == wanted
    detail = {"trials": trials, "run_s": whole, "one_worker_identical": workers_same}
    return [Figure("resume_identical", same / trials, "share", detail)]


def policy_digest(run: Path) -> str:
    """One hash over all data and policy files of a run."""
    files = sorted(
        p for part in ("dataset", "policies", "policy") for p in (run / part).rglob("*.*")
    )
    return sha256(
        b"".join(
            str(p.relative_to(run)).encode() + p.read_bytes()
            for p in files
            if p.is_file() and p.name != "experiment.toml" and not _hidden(p.relative_to(run))
        )
    )


def _hidden(path: Path) -> bool:
    return any(part.startswith(".") for part in path.parts)


def _train(out: Path, *, resume: bool = False, workers: int = 2) -> subprocess.Popen[bytes]:
    command = [sys.executable, "-m", "clothrf_core.cli", "train", str(shipped("straight.toml"))]
    command += ["--out", str(out), "--workers", str(workers)]
    for key, value in KILL_SETTINGS.items():
        command += ["--set", f"{key}={value}"]
    if resume:
        command.append("--resume")
    return subprocess.Popen(
        command, stdout=subprocess.DEVNULL, stderr=subprocess.DEVNULL, start_new_session=True
    )


def resolved_file(
    folder: Path, name: str, changes: dict[str, Any], registry: Registry
) -> tuple[Path, tuple[str, ...]]:
    """A shipped config, resolved into `folder`, and its tasks."""
    resolved = config.load(shipped(name), registry, changes)
    path = folder / "experiment.toml"
    path.write_text(resolved.text)
    return path, resolved.task_names


def job(
    path: Path, out: Path, index: int, tasks: tuple[str, ...], *, steps: int = 100
) -> RolloutJob:
    """Roll-out `index` led by the experts in turn."""
    task = tasks[index % len(tasks)]
    return RolloutJob(str(path), str(out), 0, "iteration", 1, index, task, steps=steps)


def _alone(path: Path, folder: Path, tasks: tuple[str, ...]) -> float:
    """CPU seconds a sample in this process, median of three roll-outs."""
    spans = []
    for i in range(4):
        one = job(path, folder / f"alone{i}.npz", i, tasks)
        start = time.process_time()
        one.run()
        spans.append((time.process_time() - start) / one.steps)
    return float(np.median(spans[1:]))
