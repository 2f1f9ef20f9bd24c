"""What a study does, in three stages: roll-outs, then fits and DAgger runs, then closed loops.

Within a stage everything is independent of everything else and runs on all workers.
"""

from __future__ import annotations

import dataclasses
from collections.abc import Iterator
from pathlib import Path
from typing import Any

from clothrf_core import config
from clothrf_core.errors import ClothrfError
from clothrf_core.evaluation import EpisodeJob
from clothrf_core.paper import data
from clothrf_core.paper.cells import Cell, File, Work
from clothrf_core.paper.data import Workspace, seed_of
from clothrf_core.paper.fitting import FitJob, section
from clothrf_core.paper.live import DaggerJob
from clothrf_core.paper.strange import StrangeJob
from clothrf_core.paper.study import ControllerSection, RegimeSection, conditions
from clothrf_core.provider import BuildContext
from clothrf_core.rollout import RolloutJob

# Rough seconds on one core, so that the time left is worth reading.
SAMPLE_S, ROW_FIT_S, EPISODE_STEP_S = 0.02, 1.2e-3, 0.008
TEST, LIVE = "test", "live"


def prepared(space: Workspace) -> dict[str, str]:
    """Write every experiment that the study needs; which controllers are missing, and why.

    Done once, by one process, before the workers start.
    """
    study = space.study
    space.prepare(TEST, study.regimes[study.roles.table].change)
    for name, regime in study.regimes.items():
        space.prepare(name, regime.change)
    for condition in conditions(study, quick=space.quick):
        space.prepare(condition.name, condition.change)
    for name, odd in study.strange.items():
        space.prepare(f"strange_{name}", odd.change)
    space.prepare(LIVE, study.live)
    missing = {}
    for name, controller in study.controllers.items():
        options = dict(controller.policy)
        plugin = str(options.pop("plugin"))
        try:
            provider = space.registry.find("policy", plugin)
            chosen = provider.config.model_validate(options)
            space.registry.build("policy", plugin, chosen, BuildContext(registry=space.registry))
        except ClothrfError as error:
            missing[name] = str(error)
    return missing


def rollouts(space: Workspace) -> list[File]:
    """Everything that has to be simulated before anything can be learnt."""
    study, size = space.study, space.size
    jobs: list[RolloutJob] = []
    odd: list[File] = []
    for repeat in range(size.seeds):
        for name, regime in study.regimes.items():
            jobs += data.training(space, name, repeat, shared(space, regime))
        jobs += data.testing(space, TEST, repeat, size.test_rollouts, purpose="test")
        for condition in conditions(study, quick=space.quick):
            count = size.condition_rollouts
            jobs += data.testing(space, condition.name, repeat, count, purpose="condition")
        for name, kind in study.strange.items():
            count = max(1, size.strange // size.test_steps)
            odd += [
                File(StrangeJob(job, kind.scene), job.out, SAMPLE_S * job.steps)
                for job in data.testing(space, f"strange_{name}", repeat, count, purpose="strange")
            ]
    work = [*odd, *(File(job, job.out, SAMPLE_S * job.steps) for job in jobs)]
    # Those of one experiment together: a worker builds its simulator once.
    return sorted(work, key=lambda one: Path(one.out).parents[2])


def shared(space: Workspace, regime: RegimeSection) -> int:
    """Training roll-outs of a regime."""
    share = min(1.0, regime.share * space.size.regimes)
    return max(5, round(share * space.size.rollouts))


def learning(space: Workspace, missing: dict[str, str]) -> list[Work]:
    """All fits and DAgger runs, the longest first."""
    work: list[Work] = [*daggers(space)]
    for repeat in range(space.size.seeds):
        work += [*tables(space, missing, repeat), *single_tasks(space, repeat)]
    return work


def tables(space: Workspace, missing: dict[str, str], repeat: int) -> Iterator[Cell]:
    """Every controller at every share of the table's data, and hard ones on the other regimes."""
    study, size = space.study, space.size
    for name, regime in study.regimes.items():
        count = shared(space, regime)
        table = name == study.roles.table
        wanted = list(study.controllers) if table else regime.only or study.hard()
        for controller in wanted:
            if controller in missing:
                continue
            whole = study.controllers[controller].whole or not table
            for share in [1.0] if whole else size.shares:
                yield fit(space, name, controller, share, repeat, max(2, round(share * count)))


def fit(
    space: Workspace, regime: str, controller: str, share: float, repeat: int, rollouts: int
) -> Cell:
    """One controller on some roll-outs of a regime; on the whole of it, tested on everything."""
    study = space.study
    whole, chosen = share == 1.0, study.controllers[controller]
    hard = whole and (chosen.hard or regime != study.roles.table)
    keep = whole and chosen.live and regime == study.roles.table
    tests = [TEST, *(_conditions(space, regime, chosen) if hard else ())]
    job = FitJob(
        label=f"{controller}, {share:.0%} of {regime} (seed {repeat})",
        config=str(space.experiment(regime)),
        policy=section(chosen.policy),
        columns=tuple(chosen.columns),
        train=str(space.dataset(regime, repeat).folder),
        rollouts=rollouts,
        seed=seed_of("train", repeat),
        tests=tuple((t, str(space.dataset(t, repeat).folder)) for t in tests),
        strange=_strange(space, repeat, chosen.columns) if hard else (),
        keep=str(space.out / "policies" / f"{controller}_{repeat}") if keep else "",
    )
    samples = rollouts * space.size.steps
    return Cell(job, str(fit_path(space, regime, controller, share, repeat)), samples * ROW_FIT_S)


def fit_path(space: Workspace, regime: str, controller: str, share: float, repeat: int) -> Path:
    """Where the result of a fit is."""
    folder = space.out / "cells" / "fit" / regime / controller
    return folder / f"{round(100 * share):03d}_seed_{repeat}.json"


def _conditions(space: Workspace, regime: str, controller: ControllerSection) -> Iterator[str]:
    """Conditions that a controller is tested on: those whose pictures have what it reads.

    What was trained for the swap of simulators only is tested in the simulators only.
    """
    swapped = space.study.regimes[regime].only is not None
    for condition in conditions(space.study, quick=space.quick):
        names = data.layout(space.experiment(condition.name))[0]
        known = data.readable(names, controller.columns)
        if known and (not swapped or space.study.series[condition.series].kind == "simulator"):
            yield condition.name


def _strange(space: Workspace, repeat: int, beginnings: list[str]) -> tuple[tuple[str, str], ...]:
    found = []
    for name in space.study.strange:
        dataset = space.dataset(f"strange_{name}", repeat)
        if data.readable(dataset.names, beginnings):
            found.append((name, str(dataset.folder)))
    return tuple(found)


def single_tasks(space: Workspace, repeat: int) -> Iterator[Cell]:
    """The forest for one task at a time: on all states, and on those that its expert led."""
    study, size = space.study, space.size
    regime, controller = study.roles.table, study.controllers[study.roles.forest]
    dataset = space.dataset(regime, repeat)
    if len(dataset.tasks) < 2:
        return
    for own in (False, True):
        for task in dataset.tasks:
            job = FitJob(
                label=f"{task} alone, {'its own' if own else 'all'} states (seed {repeat})",
                config=str(space.experiment(regime)),
                policy=section(controller.policy),
                columns=tuple(controller.columns),
                train=str(dataset.folder),
                rollouts=size.rollouts,
                seed=seed_of("train", repeat),
                tests=((TEST, str(space.dataset(TEST, repeat).folder)),),
                tasks=(task,),
                own=own,
            )
            samples = size.rollouts * size.steps / (len(dataset.tasks) if own else 1)
            yield Cell(job, str(single_path(space, task, repeat, own=own)), samples * ROW_FIT_S)


def single_path(space: Workspace, task: str, repeat: int, *, own: bool) -> Path:
    """Where the result of a single-task fit is."""
    kind = "own" if own else "all"
    return space.out / "cells" / "single" / f"{kind}_{task}_seed_{repeat}.json"


def dagger_names(space: Workspace) -> list[str]:
    """The kinds of DAgger run of this size."""
    return [n for n, kind in space.study.dagger.items() if kind.quick or not space.quick]


def daggers(space: Workspace) -> Iterator[Cell]:
    """DAgger runs with and without rebuilding."""
    study, size = space.study, space.size
    for repeat in range(size.dagger_seeds):
        for name in dagger_names(space):
            kind = study.dagger[name]
            change: dict[str, Any] = {
                "policy": study.controllers[study.roles.forest].policy,
                **kind.change,
                "run.seed": seed_of("train", repeat),
                "training.iterations": size.iterations,
                "training.rollouts": size.dagger_rollouts,
                "training.steps": size.steps,
                "training.stride": study.stride,
                "training.from_rest": study.from_rest,
                "training.rebuild": kind.rebuild,
                "evaluation.rollouts": max(2, size.test_rollouts // 6),
                "evaluation.steps": size.steps,
                "evaluation.disturbance": study.disturbance,
                "collection.engine": "sequential",
            }
            path = space.prepare(f"dagger_{name}_{repeat}", change)
            job = DaggerJob(
                label=f"DAgger, {kind.title} (seed {repeat})",
                config=str(path),
                run_folder=str(dagger_folder(space, name, repeat)),
                test=str(space.dataset(TEST, repeat).folder),
                columns=tuple(study.controllers[study.roles.forest].columns),
            )
            samples = size.iterations * size.dagger_rollouts * size.steps
            seconds = samples * (SAMPLE_S + 0.5 * size.iterations * ROW_FIT_S * kind.rebuild)
            yield Cell(job, str(dagger_path(space, name, repeat)), seconds)


def dagger_folder(space: Workspace, name: str, repeat: int) -> Path:
    """The run folder of a DAgger run."""
    return space.out / "dagger" / f"{name}_{repeat}"


def dagger_path(space: Workspace, name: str, repeat: int) -> Path:
    """Where the result of a DAgger run is."""
    return space.out / "cells" / "dagger" / f"{name}_seed_{repeat}.json"


def live_policies(space: Workspace, missing: dict[str, str], repeat: int) -> dict[str, str]:
    """Controllers of the closed loop and their policy folders; the expert's is empty."""
    study = space.study
    found = {"expert": ""}
    for name in dagger_names(space):
        folder = dagger_folder(space, name, repeat)
        if study.dagger[name].rebuild:
            found[f"{name}_1"] = str(folder / "policies" / "iteration_001")
        found[f"{name}_n"] = str(folder / "policy")
    for name, controller in study.controllers.items():
        if controller.live and name not in missing:
            found[f"cloned_{name}"] = str(space.out / "policies" / f"{name}_{repeat}")
    return found


def closed_loops(space: Workspace, missing: dict[str, str]) -> list[Work]:
    """Every controller alone under noise, on every task and on sequences of them."""
    study, size = space.study, space.size
    path = space.experiment(LIVE)
    tasks = data.layout(path)[1]
    rate = config.load(path, space.registry).experiment.run.rate_hz
    once = round(len(tasks) * study.sequence_s * rate)  # every task of a sequence in turn
    work: list[Work] = []
    for repeat in range(size.dagger_seeds):
        for name, folder in live_policies(space, missing, repeat).items():
            for index in range(size.episodes):
                plain = EpisodeJob(
                    config=str(path),
                    policy=folder,
                    task=tasks[0],
                    seed=seed_of("episode", repeat),
                    index=index,
                    targets=size.targets,
                    max_steps=size.max_steps,
                    every_s=study.sequence_s,
                )
                jobs = {task: dataclasses.replace(plain, task=task) for task in tasks}
                if len(tasks) > 1:
                    jobs["sequence"] = dataclasses.replace(
                        plain, then=tuple(tasks[1:]), targets=once, max_steps=once
                    )
                for task, job in jobs.items():
                    out = live_path(space, name, task, repeat, index)
                    work.append(Cell(job, str(out), job.max_steps * EPISODE_STEP_S))
    return work


def live_path(space: Workspace, controller: str, task: str, repeat: int, index: int) -> Path:
    """Where the result of an episode is."""
    folder = space.out / "cells" / "live" / controller / task
    return folder / f"seed_{repeat}_{index}.json"
