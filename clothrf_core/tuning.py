"""Hyper-parameters by cross-validation over whole roll-outs, for any policy plugin.

What to try stands in the config's ``[tune.policy]``, or is declared by the policy's own config
model (``Field(..., json_schema_extra={"tune": [...]})``). The config as it is always takes part.
"""

from __future__ import annotations

import functools
import json
import math
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from clothrf_core import compose, config
from clothrf_core.collection import engine
from clothrf_core.dataset import Dataset
from clothrf_core.errors import ConfigError
from clothrf_core.evaluation import held_out, interval
from clothrf_core.expert_data import expert_jobs
from clothrf_core.files import atomic_write, csv_bytes, json_bytes
from clothrf_core.paper.cells import Cell, File, Work, do, result
from clothrf_core.provider import Setting
from clothrf_core.registry import Registry
from clothrf_core.run_folder import RunFolder
from clothrf_core.sections import TuneSection
from clothrf_core.tuning_grid import Options, combinations, nested

FOLD_STREAM, FIT_STREAM = 22, 23
THIRD = 3
# Rough, for the time left.
SAMPLE_S, ROW_FIT_S, LEAST_FIT_S = 0.012, 1e-3, 3.0


@dataclass(frozen=True, slots=True)
class TrialJob:
    """One combination of options fitted on all folds but one and judged on that one.

    Attributes:
        config: resolved experiment file.
        options: JSON of dotted option -> value.
        data: folder of the data set.
        rollouts: how many of its roll-outs take part.
        fold: the one left out.
        folds: how many there are.
        seed: of the fit and of the folds.
    """

    config: str
    options: str
    data: str
    rollouts: int
    fold: int
    folds: int
    seed: int

    @property
    def name(self) -> str:
        """How messages call it."""
        what = words(json.loads(self.options))
        return f"{what}, fold {self.fold + 1} of {self.folds}, {self.rollouts} roll-outs"

    def run(self) -> dict[str, Any]:
        """Error numbers on the fold, see `held_out`."""
        registry = Registry.installed()
        resolved = changed(Path(self.config), registry, json.loads(self.options))
        view = _view(self.data)
        place = folds_of(len(np.unique(view.groups)), self.rollouts, self.folds, self.seed)
        fold = place[np.asarray(view.groups)]
        seed = np.random.SeedSequence(self.seed, spawn_key=(FIT_STREAM, self.fold))
        policy = compose.new_policy(resolved, registry)
        policy.fit(view.rows((fold >= 0) & (fold != self.fold)), np.random.default_rng(seed))
        return held_out(policy, view.rows(fold == self.fold))


def folds_of(total: int, used: int, folds: int, seed: int) -> NDArray[np.int64]:
    """(total,) fold of each roll-out; -1 = takes no part. More roll-outs keep earlier folds."""
    order = np.random.default_rng(np.random.SeedSequence(seed, spawn_key=(FOLD_STREAM,)))
    place = np.full(total, -1, np.int64)
    chosen = order.permutation(total)[:used]
    place[chosen] = np.arange(len(chosen)) % folds
    return place


def tune(
    path: Path, setting: Setting, out: Path, overrides: Mapping[str, Any] | None = None
) -> list[dict[str, Any]]:
    """Try what the config at `path` asks for; a row a combination, the best first.

    Writes ``tune.json``, ``tune.csv`` and ``best.toml`` into `out`; a killed search goes on there.
    The error of the best of many is a little too good: measure it on roll-outs of another seed.

    Raises:
        ConfigError: there is nothing to try, an option is unknown, or `out` holds another search.
    """
    registry = Registry.installed()
    resolved = config.load(path, registry, overrides)
    section = resolved.experiment.tune or TuneSection()
    tried = combinations(resolved, registry, section)
    again = (out / "experiment.toml").exists()
    run = RunFolder.start(out, resolved, resume=again)
    note = {"section": section.model_dump(mode="json"), "tried": tried}
    _same(out / "search.json", note)
    work = _rollouts(run, resolved, registry, section)
    rounds = list(schedule(len(tried), section))
    steps = resolved.experiment.training.steps
    fits = [section.folds * max(LEAST_FIT_S, ROW_FIT_S * n * steps) for _, n in rounds]
    setting.plan(
        sum(w.seconds for w in work) + sum(c * f for (c, _), f in zip(rounds, fits, strict=True))
    )
    runner = engine(resolved.experiment.collection)
    left = list(range(len(tried)))
    rows: dict[int, dict[str, Any]] = {}
    try:
        do(work, runner, setting)
        for (count, used), cost in zip(rounds, fits, strict=True):
            left = left[:count]
            cells = {
                number: _cells(run, resolved, section, tried[number], number, used, cost)
                for number in left
            }
            do([cell for mine in cells.values() for cell in mine], runner, setting)
            for number, mine in cells.items():
                rows[number] = _row(number, tried[number], used, mine)
            # The config as it is stays to the end: all others are compared with it.
            left.sort(key=lambda number: (number > 0, rows[number]["rms_mm"], number))
    finally:
        runner.close()
    order = sorted(rows.values(), key=lambda r: (-r["rollouts"], r["rms_mm"], r["number"]))
    order = [against(row, rows[0]) for row in order]
    best = changed(run.experiment, registry, order[0]["options"])
    atomic_write(out / "best.toml", best.text.encode())
    atomic_write(out / "tune.json", json_bytes(order))
    atomic_write(out / "tune.csv", csv_bytes(table(order)))
    return order


def against(row: Mapping[str, Any], now: Mapping[str, Any]) -> dict[str, Any]:
    """`row` and how its error differs from the config as it is, fold by fold.

    Folds differ more from each other than combinations do, so only the differences tell.
    """
    if row["rollouts"] != now["rollouts"]:
        return {**row, "change_mm": None, "change_half_mm": None}
    mean, half = interval(np.array(row["each_mm"]) - np.array(now["each_mm"]))
    return {**row, "change_mm": mean, "change_half_mm": half}


def words(options: Options) -> str:
    """A combination as a user would write it."""
    return ", ".join(f"{k} = {v}" for k, v in options.items()) or "as it is"


def table(order: Sequence[Mapping[str, Any]]) -> list[list[str]]:
    """The search as text, the best first; only rows of the last round saw all roll-outs."""
    lines = [["rank", "options", "roll-outs", "RMS, mm", "NRE", "against as it is, mm (± 95 %)"]]
    for rank, row in enumerate(order, 1):
        change = ""
        if row["change_mm"] is not None and row["options"]:
            change = f"{row['change_mm']:+.2f} ± {row['change_half_mm']:.2f}"
        numbers = (str(row["rollouts"]), f"{row['rms_mm']:.2f}", f"{row['nre']:.4f}", change)
        lines.append([str(rank), words(row["options"]), *numbers])
    return lines


def changed(path: Path, registry: Registry, options: Mapping[str, Any]) -> config.Resolved:
    """The experiment at `path` with some options of its policy changed, and without `[tune]`."""
    data = config.read_toml(path)
    data.pop("tune", None)
    data["policy"] = nested(options, data["policy"])
    return config.resolve(data, registry, folder=path.parent, source=str(path))


def schedule(candidates: int, section: TuneSection) -> list[tuple[int, int]]:
    """(combinations, roll-outs) of every round, the last on all roll-outs."""
    if section.search != "halving" or candidates <= THIRD:
        return [(candidates, section.rollouts)]
    rounds = max(1, math.floor(math.log(candidates, THIRD)))
    least = 2 * section.folds
    plan = []
    for number in range(rounds):
        used = max(least, section.rollouts // THIRD ** (rounds - 1 - number))
        plan.append((max(2, candidates // THIRD**number), min(used, section.rollouts)))
    return plan


@functools.lru_cache(maxsize=1)
def _view(folder: str) -> Any:
    data = Dataset.open(Path(folder))
    return data.view(data.paths())


def _rollouts(
    run: RunFolder, resolved: config.Resolved, registry: Registry, section: TuneSection
) -> list[Work]:
    experiment = resolved.experiment
    names = compose.extractor(resolved, registry).names
    data = Dataset.create(run.dataset, names, resolved.task_names)
    jobs = expert_jobs(
        run.experiment,
        data,
        seed=experiment.run.seed,
        kind="iteration",
        count=section.rollouts,
        steps=experiment.training.steps,
        stride=experiment.training.stride,
        disturbance=experiment.evaluation.disturbance,
        from_rest=experiment.training.from_rest,
    )
    return [File(job, job.out, SAMPLE_S * job.steps) for job in jobs]


def _cells(
    run: RunFolder,
    resolved: config.Resolved,
    section: TuneSection,
    options: Options,
    number: int,
    used: int,
    cost: float,
) -> list[Cell]:
    folder = run.path / "cells" / f"rollouts_{used:04d}" / f"candidate_{number:03d}"
    return [
        Cell(
            TrialJob(
                config=str(run.experiment),
                options=json.dumps(options, sort_keys=True),
                data=str(run.dataset),
                rollouts=used,
                fold=fold,
                folds=section.folds,
                seed=resolved.experiment.run.seed,
            ),
            str(folder / f"fold_{fold}.json"),
            cost / section.folds,
        )
        for fold in range(section.folds)
    ]


def _row(number: int, options: Options, used: int, cells: Sequence[Cell]) -> dict[str, Any]:
    found = [result(Path(cell.out)) for cell in cells]
    each = [f["rms_mm"] for f in found]
    return {
        "number": number,
        "options": options,
        "rollouts": used,
        "rms_mm": float(np.mean(each)),
        "each_mm": each,
        "nre": float(np.mean([f["nre"] for f in found])),
    }


def _same(path: Path, note: dict[str, Any]) -> None:
    """Keep `note`, or refuse to go on with another."""
    data = json_bytes(note)
    if path.exists() and path.read_bytes() != data:
        raise ConfigError(
            f"{path.parent}: holds another search, see {path}. Choose another folder with --out"
        )
    atomic_write(path, data)
