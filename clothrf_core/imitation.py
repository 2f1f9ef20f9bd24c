"""DAgger on one screen (Ross, Gordon, Bagnell 2011, algorithm 3.1).

An expert who sees the true hands labels every state; a mixture of expert and learner acts; the
data grow; the policy is fitted anew on all of them; the one that is best on held-out roll-outs is
kept.
"""

from __future__ import annotations

import time
from collections.abc import Callable, Sequence
from typing import Any, Protocol

import numpy as np

from clothrf_core import compose, config
from clothrf_core.collection import Engine, Job, collect, engine
from clothrf_core.dataset import Dataset
from clothrf_core.errors import ConfigError, DataError
from clothrf_core.evaluation import held_out
from clothrf_core.interfaces import Policy, Refittable
from clothrf_core.registry import Registry
from clothrf_core.rollout import RolloutJob
from clothrf_core.run_folder import RunFolder
from clothrf_core.types import DatasetView

FIT_STREAM = 7  # spawn key of the fitting generators, apart from those of the roll-outs


class Progress(Protocol):
    """Where the run tells how far it is."""

    def advance(self, what: str) -> None:
        """One more unit of work is done."""

    def finished(self, record: dict[str, Any]) -> None:
        """An iteration is done; `record` is its line of metrics.jsonl."""


def beta(iteration: int, decay: float) -> float:
    """Share of the expert in iteration 1, 2, ...: beta_i = decay^(i - 1)."""
    return float(decay ** (iteration - 1))


def dagger(run: RunFolder, registry: Registry, progress: Progress) -> list[dict[str, Any]]:
    """Train until all iterations are done; picks up where a killed run stopped.

    Returns one record an iteration. Same seed, same files, bit for bit, for any number of workers.
    """
    resolved = run.resolved(registry)
    training = resolved.experiment.training
    names = compose.extractor(resolved, registry).names
    data = Dataset.create(run.dataset, names, resolved.task_names)
    workers = engine(resolved.experiment.collection)
    records = run.metrics()
    try:
        _collect(workers, held_out_jobs(run, resolved, data), progress)
        truth = data.view(data.paths(kind="heldout"))
        for iteration in range(len(records) + 1, training.iterations + 1):
            start = time.perf_counter()
            _collect(workers, iteration_jobs(run, resolved, data, iteration), progress)
            collected = time.perf_counter()
            view = data.view(data.paths(up_to=iteration))
            policy, facts = fit(run, resolved, registry, view, iteration)
            seconds = {key: facts.pop(key) for key in sorted(facts) if key.endswith("_s")}
            record = {
                "iteration": iteration,
                "beta": beta(iteration, training.beta),
                **facts,
                **held_out(policy, truth),
            }
            records.append(record)
            fitted = time.perf_counter()
            spent = {"collect_s": collected - start, "fit_and_test_s": fitted - collected}
            run.finish(records, {**spent, **seconds})
            progress.finished(record)
    finally:
        workers.close()
    run.keep_best(best(records))
    return records


def clone(
    run: RunFolder, registry: Registry, data: Dataset, progress: Progress
) -> list[dict[str, Any]]:
    """Behaviour cloning: one fit on a finished data set; nothing is simulated.

    Returns one record, as `dagger` does. Tested on the held-out roll-outs of `data`; where there
    are none, on every fifth roll-out, which is then not learned from.
    """
    learned, tested = data.paths(), data.paths(kind="heldout")
    if not tested:
        tested = learned[::5]
        learned = [path for path in learned if path not in tested]
    if not learned:
        raise DataError(
            f"{data.folder}: expected at least two roll-outs, one to learn from and one to test "
            f"on, found {len(tested)}"
        )
    start = time.perf_counter()
    view = data.view(learned)
    policy, facts = fit(run, run.resolved(registry), registry, view, 1)
    seconds = {key: facts.pop(key) for key in sorted(facts) if key.endswith("_s")}
    record = {"iteration": 1, "beta": 1.0, **facts, **held_out(policy, data.view(tested))}
    run.finish([record], {"fit_and_test_s": time.perf_counter() - start, **seconds})
    progress.advance("fit")
    progress.finished(record)
    run.keep_best(1)
    return [record]


def fit(
    run: RunFolder,
    resolved: config.Resolved,
    registry: Registry,
    view: DatasetView,
    iteration: int,
) -> tuple[Policy, dict[str, Any]]:
    """Fit a policy on `view` and save it as the one of `iteration`.

    It is a fresh one, or, with ``training.rebuild = false``, the last one refitted.

    Raises:
        ConfigError: the last policy has to be refitted and cannot be.
    """
    seed = resolved.experiment.run.seed
    rng = np.random.default_rng(np.random.SeedSequence(seed, spawn_key=(FIT_STREAM, iteration)))
    policy = compose.new_policy(resolved, registry)
    if resolved.experiment.training.rebuild or iteration == 1:
        facts = policy.fit(view, rng)
    elif isinstance(policy, Refittable):
        last = policy.load(run.policy(iteration - 1))
        facts = last.refit(view, rng)
        policy = last
    else:
        raise ConfigError(
            f"training.rebuild = false needs a policy that can be refitted; "
            f"'{resolved.components['policy'].plugin}' has no method 'refit'. Leave it true"
        )
    compose.save_policy(run.policy(iteration), policy, resolved, view.names)
    return policy, {"samples": len(view), **facts}


def iteration_jobs(
    run: RunFolder, resolved: config.Resolved, data: Dataset, iteration: int
) -> list[RolloutJob]:
    """The roll-outs of one iteration; the tasks take turns in leading them."""
    experiment = resolved.experiment
    training, tasks = experiment.training, resolved.task_names
    return [
        RolloutJob(
            config=str(run.experiment),
            out=str(data.path(iteration, index)),
            seed=experiment.run.seed,
            kind="iteration",
            iteration=iteration,
            index=index,
            task=tasks[((iteration - 1) * training.rollouts + index) % len(tasks)],
            steps=training.steps,
            stride=training.stride,
            beta=beta(iteration, training.beta),
            mix=training.mix,
            from_rest=training.from_rest,
            policy=str(run.policy(iteration - 1)) if iteration > 1 else "",
        )
        for index in range(training.rollouts)
    ]


def held_out_jobs(run: RunFolder, resolved: config.Resolved, data: Dataset) -> list[RolloutJob]:
    """Roll-outs that are never trained on; every second one is pushed off the expert's path."""
    experiment = resolved.experiment
    tasks = resolved.task_names
    return [
        RolloutJob(
            config=str(run.experiment),
            out=str(data.path(0, index, kind="heldout")),
            seed=experiment.run.seed,
            kind="heldout",
            iteration=0,
            index=index,
            task=tasks[(index // 2) % len(tasks)],
            steps=experiment.evaluation.steps,
            stride=experiment.training.stride,
            disturbance=experiment.evaluation.disturbance if index % 2 else 0.0,
            from_rest=experiment.training.from_rest,
        )
        for index in range(experiment.evaluation.rollouts)
    ]


def best(records: Sequence[dict[str, Any]]) -> int:
    """The iteration with the least held-out error; the earliest of equals."""
    return int(min(records, key=lambda r: (r["rms_mm"], r["iteration"]))["iteration"])


def _collect(workers: Engine, jobs: Sequence[Job], progress: Progress) -> None:
    done: Callable[[Job], None] = lambda job: progress.advance(job.name)  # noqa: E731
    collect(jobs, workers, done)
