"""Two Dask workers against one, runs in which a worker is killed, and 100,000 samples."""

from __future__ import annotations

import contextlib
import os
import random
import signal
import statistics
import tempfile
import threading
import time
from dataclasses import dataclass
from pathlib import Path

from clothrf_core import config
from clothrf_core.bench import job, resolved_file
from clothrf_core.cluster import Cluster
from clothrf_core.collection import collect, engine
from clothrf_core.errors import RolloutFailed
from clothrf_core.files import sha256
from clothrf_core.provider import Figure
from clothrf_core.registry import Registry
from clothrf_core.rollout import RolloutJob
from clothrf_core.sections import CollectionSection

WORKERS = 4  # of the runs in which one is killed


def two_workers(quick: bool) -> list[Figure]:  # noqa: FBT001
    """Throughput of two Dask workers over one; roll-outs of 100 steps.

    Both clusters are there from the beginning and take turns, because a shared machine is faster
    at one minute than at the next; the figure is the median of the rounds.
    """
    rounds, count, many = (1, 8, 200) if quick else (5, 20, 2000)
    seconds: dict[int, list[float]] = {1: [], 2: []}
    with tempfile.TemporaryDirectory() as name, contextlib.ExitStack() as stack:
        path, tasks = resolved_file(Path(name), "three_tasks.toml", {}, Registry.installed())

        def roll_outs(folder: str, numbers: range) -> list[RolloutJob]:
            return [job(path, Path(name) / folder / f"{i}.npz", i, tasks) for i in numbers]

        clusters = {}
        for workers in seconds:
            clusters[workers] = Cluster(CollectionSection(engine="dask", workers=workers))
            stack.callback(clusters[workers].close)
            collect(roll_outs(f"warm{workers}", range(4)), clusters[workers])
        for turn in range(rounds):
            for workers, runner in clusters.items():
                jobs = roll_outs(f"{workers}", range(turn * count, (turn + 1) * count))
                start = time.perf_counter()
                collect(jobs, runner)
                seconds[workers].append(time.perf_counter() - start)
        start = time.perf_counter()
        collect([Nothing(i) for i in range(many)], clusters[2])
        handling_s = (time.perf_counter() - start) / many
        size = (Path(name) / "1" / "0.npz").stat().st_size
    ratios = [one / two for one, two in zip(seconds[1], seconds[2], strict=True)]
    detail = {
        "rounds": rounds,
        "rollouts_a_round": count,
        "one_s": statistics.median(seconds[1]),
        "two_s": statistics.median(seconds[2]),
        "ratios": ", ".join(f"{ratio:.2f}" for ratio in sorted(ratios)),
    }
    return [
        Figure("dask_two_workers", statistics.median(ratios), "ratio", detail),
        _hundred_workers(statistics.median(seconds[1]) / count, handling_s, size),
    ]


@dataclass(frozen=True, slots=True)
class Nothing:
    """A job that costs what the scheduler costs."""

    index: int

    @property
    def name(self) -> str:
        """How messages call it."""
        return f"nothing {self.index}"

    def run(self) -> str:
        """Nothing."""
        return self.name


def _hundred_workers(rollout_s: float, handling_s: float, size: int) -> Figure:
    """What 100 workers would saturate, from what one roll-out costs everybody.

    A roll-out keeps a worker busy for `rollout_s`, the scheduler and this process for `handling_s`
    (measured with jobs that do nothing), and the shared folder for `size` bytes. So the scheduler
    is full at ``rollout_s / handling_s`` workers; a folder of 100 MB/s (a gigabit network, or one
    disk) at ``100 MB/s * rollout_s / size``. The smaller one is the bottleneck.
    """
    scheduler = rollout_s / handling_s
    folder = 1e8 * rollout_s / size
    detail = {
        "bottleneck": "scheduler and submitting process" if scheduler < folder else "shared folder",
        "scheduler_rollouts_per_s": 1.0 / handling_s,
        "scheduler_full_at_workers": scheduler,
        "folder_full_at_workers": folder,
        "rollout_s": rollout_s,
        "rollout_bytes": size,
        "samples_per_s_of_100": min(100.0, scheduler, folder) * 100.0 / rollout_s,
        "folder_mb_per_s_of_100": min(100.0, scheduler, folder) * size / rollout_s / 1e6,
    }
    return Figure("dask_saturation_workers", min(scheduler, folder), "workers", detail)


def killed_worker(quick: bool) -> list[Figure]:  # noqa: FBT001
    """One of four workers killed at a random moment: does every run end with the same data?"""
    trials, count = (3, 8) if quick else (20, 16)
    moments = random.Random(0)
    with tempfile.TemporaryDirectory() as name:
        path, tasks = resolved_file(Path(name), "three_tasks.toml", {}, Registry.installed())

        def jobs(folder: Path) -> list[RolloutJob]:
            return [job(path, folder / f"{i:02d}.npz", i, tasks, steps=30) for i in range(count)]

        runner = Cluster(CollectionSection(engine="dask", workers=WORKERS))
        try:
            collect(jobs(Path(name) / "warm"), runner)
            start = time.perf_counter()
            collect(jobs(Path(name) / "whole"), runner)
            whole = time.perf_counter() - start
            wanted, same = _digest(Path(name) / "whole"), 0
            for trial in range(trials):
                victim = moments.choice(runner.worker_pids())
                timer = threading.Timer(
                    moments.uniform(0.0, whole), os.kill, (victim, signal.SIGKILL)
                )
                timer.start()
                collect(jobs(Path(name) / f"t{trial}"), runner)
                timer.join()
                same += _digest(Path(name) / f"t{trial}") == wanted
                _wait_for_another(runner, victim)
        finally:
            runner.close()
    detail = {"trials": trials, "rollouts": count, "workers": WORKERS}
    return [Figure("dask_kill_identical", same / trials, "share", detail)]


def _wait_for_another(runner: Cluster, victim: int, timeout_s: float = 60.0) -> None:
    """Return when a new worker has taken the place of the killed one and answers.

    The scheduler may not have noticed yet that the old one is gone; a worker that is killed while
    it starts is not replaced, because its nanny takes that for its own fault.
    """
    give_up = time.monotonic() + timeout_s
    while True:
        try:
            pids = runner.worker_pids()
        except OSError:
            pids = []
        if len(pids) == WORKERS and victim not in pids:
            return
        if time.monotonic() > give_up:
            raise RolloutFailed(f"expected {WORKERS} workers again, found {len(pids)}")
        time.sleep(0.1)


def hundred_thousand(quick: bool) -> list[Figure]:  # noqa: FBT001
    """Seconds for 100,000 samples of three tasks on two cores; the quick form extrapolates."""
    rollouts = 40 if quick else 1000
    registry = Registry.installed()
    with tempfile.TemporaryDirectory() as name:
        path, tasks = resolved_file(Path(name), "three_tasks.toml", {}, registry)
        jobs = [job(path, Path(name) / f"{i}.npz", i, tasks) for i in range(rollouts + 2)]
        workers = engine(config.load(path, registry).experiment.collection)
        try:
            collect(jobs[:2], workers)
            start = time.perf_counter()
            collect(jobs[2:], workers)
            seconds = time.perf_counter() - start
        finally:
            workers.close()
    detail = {"measured_samples": 100 * rollouts, "measured_s": seconds}
    return [Figure("samples_100k_s", seconds * 1000 / rollouts, "s", detail)]


def _digest(folder: Path) -> str:
    return sha256(b"".join(p.read_bytes() for p in sorted(folder.glob("*.npz"))))
