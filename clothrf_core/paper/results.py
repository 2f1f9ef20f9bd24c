"""What came out of a study: every number with the 95 % interval of its mean over the seeds."""

from __future__ import annotations

from collections.abc import Callable, Iterable, Mapping, Sequence
from typing import Any

import numpy as np

from clothrf_core.evaluation import interval
from clothrf_core.paper import data, stages
from clothrf_core.paper.cells import result, timing
from clothrf_core.paper.data import Workspace
from clothrf_core.paper.study import conditions

MEASURES = ("rms_mm", "mse_m2", "nre")


def number(values: Iterable[float]) -> dict[str, Any]:
    """Mean, half-width of its 95 % interval, and the values themselves, one a seed."""
    each = [float(v) for v in values]
    mean, half = interval(np.array(each))
    return {"mean": mean, "half": half if len(each) > 1 else None, "each": each}


def collected(space: Workspace, missing: Mapping[str, str]) -> dict[str, Any]:
    """Everything that the cells of a finished study say; equal seeds give equal numbers."""
    return {
        "missing": dict(missing),
        "table": list(table(space, missing)),
        "conditions": list(hard(space, missing)),
        "dagger": {name: dagger(space, name) for name in stages.dagger_names(space)},
        "live": list(live(space, missing)),
        "joint": list(joint(space)),
        "strange": list(strange(space, missing)),
        "confidence": confidence(space),
    }


def table(space: Workspace, missing: Mapping[str, str]) -> Iterable[dict[str, Any]]:
    """One row a controller and share of the data."""
    study, regime = space.study, space.study.roles.table
    for controller in study.controllers:
        for share in space.size.shares:
            left_out = study.controllers[controller].whole and share != 1.0
            if controller in missing or left_out:
                continue
            cells = [
                result(stages.fit_path(space, regime, controller, share, repeat))
                for repeat in range(space.size.seeds)
            ]
            tests = [cell["tests"][stages.TEST] for cell in cells]
            grown = [cell["facts"].get("leaves") for cell in cells]
            yield {
                "controller": controller,
                "share": share,
                "samples": number(cell["samples"] for cell in cells),
                "leaves": None if None in grown else number(grown),
                **errors(tests),
                "tasks": {
                    task: errors([test["tasks"][task] for test in tests])
                    for task in tests[0]["tasks"]
                },
            }


def errors(tests: Sequence[Mapping[str, Any]]) -> dict[str, Any]:
    """`number` of every measure of the error over seeds."""
    return {measure: number(test[measure] for test in tests) for measure in MEASURES}


def trained(space: Workspace, missing: Mapping[str, str]) -> Iterable[tuple[str, str]]:
    """(regime, controller) of everything that was tested on the hard conditions."""
    study = space.study
    for name, regime in study.regimes.items():
        for controller in regime.only or study.hard():
            if controller not in missing:
                yield name, controller


def hard(space: Workspace, missing: Mapping[str, str]) -> Iterable[dict[str, Any]]:
    """One row a regime, controller, series and level; growth over the level 0 of the series."""
    study, seeds = space.study, range(space.size.seeds)
    levels = conditions(study, quick=space.quick)
    for regime, controller in trained(space, missing):
        cells = [result(stages.fit_path(space, regime, controller, 1.0, r)) for r in seeds]
        for condition in levels:
            if condition.name not in cells[0]["tests"]:
                continue
            first = study.series[condition.series].zero or condition.series
            zero = next(c.name for c in levels if c.series == first)
            rms = [cell["tests"][condition.name]["rms_mm"] for cell in cells]
            base = [cell["tests"][zero]["rms_mm"] for cell in cells]
            yield {
                "regime": regime,
                "controller": controller,
                "series": condition.series,
                "level": condition.level,
                "rms_mm": number(rms),
                "nre": number(cell["tests"][condition.name]["nre"] for cell in cells),
                "confidence": number(cell["tests"][condition.name]["confidence"] for cell in cells),
                "growth": number(a / b - 1.0 for a, b in zip(rms, base, strict=True)),
            }


def dagger(space: Workspace, name: str) -> dict[str, Any]:
    """Error and leaves after each iteration of one kind of DAgger run."""
    cells = [
        result(stages.dagger_path(space, name, repeat)) for repeat in range(space.size.dagger_seeds)
    ]
    rows = []
    for same in zip(*(cell["iterations"] for cell in cells), strict=True):
        row = {
            "iteration": same[0]["iteration"],
            "samples": number(r["samples"] for r in same),
            **errors([r["test"] for r in same]),
            "tasks": {
                task: errors([r["test"]["tasks"][task] for r in same])
                for task in same[0]["test"]["tasks"]
            },
        }
        if all("leaves" in r for r in same):
            row["leaves"] = number(r["leaves"] for r in same)
        rows.append(row)
    return {"iterations": rows, "best": [cell["best"] for cell in cells]}


def live(space: Workspace, missing: Mapping[str, str]) -> Iterable[dict[str, Any]]:
    """One row a controller and task of the closed loop; a seed's value is the mean of episodes."""
    tasks = data.layout(space.experiment(stages.LIVE))[1]
    asked = [*tasks, "sequence"] if len(tasks) > 1 else list(tasks)
    for controller in stages.live_policies(space, dict(missing), 0):
        for task in asked:
            means, worst, invalid = [], [], []
            for repeat in range(space.size.dagger_seeds):
                found = [
                    result(stages.live_path(space, controller, task, repeat, index))
                    for index in range(space.size.episodes)
                ]
                means.append(float(np.mean([f["mean_mm"] for f in found])))
                worst.append(float(np.mean([f["p95_mm"] for f in found])))
                invalid.append(sum(f["invalid"] for f in found))
            yield {
                "controller": controller,
                "task": task,
                "mean_mm": number(means),
                "p95_mm": number(worst),
                "invalid": number(invalid),
            }


def joint(space: Workspace) -> Iterable[dict[str, Any]]:
    """One row a task: the joint forest against forests of that task alone, same test rows.

    ``relative`` compares forests with the same number of labelled samples for that task (all
    states), ``relative_own`` gives all of them together the same total (each the states that its
    own expert led). Both are (joint - single) / single, of the RMS and of the mean square.
    """
    study, seeds = space.study, range(space.size.seeds)
    forest = study.roles.forest
    whole = [result(stages.fit_path(space, study.roles.table, forest, 1.0, r)) for r in seeds]
    tasks = list(whole[0]["tests"][stages.TEST]["tasks"])
    for task in tasks if len(tasks) > 1 else []:
        together = [cell["tests"][stages.TEST]["tasks"][task] for cell in whole]
        row: dict[str, Any] = {"task": task, "joint_mm": number(t["rms_mm"] for t in together)}
        for own, key in ((False, ""), (True, "_own")):
            cells = [result(stages.single_path(space, task, r, own=own)) for r in seeds]
            alone = [cell["tests"][stages.TEST]["tasks"][task] for cell in cells]
            row[f"single{key}_mm"] = number(a["rms_mm"] for a in alone)
            row[f"single{key}_samples"] = cells[0]["samples"]
            for measure, suffix in (("rms_mm", ""), ("mse_m2", "_mse")):
                row[f"relative{key}{suffix}"] = number(
                    t[measure] / a[measure] - 1.0 for t, a in zip(together, alone, strict=True)
                )
        yield row


def strange(space: Workspace, missing: Mapping[str, str]) -> Iterable[dict[str, Any]]:
    """One row a regime, controller and kind of picture that should not be trusted."""
    for regime, controller in trained(space, missing):
        cells = [
            result(stages.fit_path(space, regime, controller, 1.0, repeat))
            for repeat in range(space.size.seeds)
        ]
        for case in cells[0]["auroc"]:
            yield {
                "regime": regime,
                "controller": controller,
                "case": case,
                "auroc": number(cell["auroc"][case] for cell in cells),
            }


def confidence(space: Workspace) -> list[list[float]]:
    """Stated confidence, RMS error in mm and rows of the default forest, first seed."""
    study = space.study
    path = stages.fit_path(space, study.roles.table, study.roles.forest, 1.0, 0)
    curve: list[list[float]] = result(path)["confidence_curve"]
    return curve


def seconds(space: Workspace, missing: Mapping[str, str]) -> list[dict[str, Any]]:
    """How long the fits on all of the table's data took, and one answer; not reproducible."""
    rows = []
    for controller in space.study.controllers:
        if controller in missing:
            continue
        spent = [
            timing(stages.fit_path(space, space.study.roles.table, controller, 1.0, repeat))
            for repeat in range(space.size.seeds)
        ]
        known = [s for s in spent if "fit" in s]
        if known:
            rows.append(
                {
                    "controller": controller,
                    "fit_s": float(np.median([s["fit"] for s in known])),
                    "act_us": float(np.median([s["act_us"] for s in known])),
                }
            )
    return rows


def chosen(rows: Iterable[Mapping[str, Any]], **wanted: Any) -> list[Mapping[str, Any]]:
    """The rows in which all of `wanted` hold."""
    test: Callable[[Mapping[str, Any]], bool] = lambda row: all(  # noqa: E731
        row.get(key) == value for key, value in wanted.items()
    )
    return [row for row in rows if test(row)]
