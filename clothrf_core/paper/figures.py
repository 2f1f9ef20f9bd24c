"""The figures of `clothrf bench paper`: names and definitions, nothing measured here."""

from __future__ import annotations

from collections.abc import Iterable, Mapping, Sequence
from typing import Any

import numpy as np

from clothrf_core.paper.results import chosen, number
from clothrf_core.paper.study import Study
from clothrf_core.provider import Figure

Rows = Mapping[str, Any]


def figures(study: Study, found: Rows) -> list[Figure]:
    """All figures that the study's roles allow."""
    made = [
        *accuracy(study, found),
        *penalty(found),
        *iterations(study, found),
        *unseen(study, found),
        *occlusion(study, found),
        *swap(study, found),
        *leaves(study, found),
        *trust(study, found),
    ]
    return [figure for figure in made if figure is not None]


def accuracy(study: Study, found: Rows) -> Iterable[Figure]:
    """The forest's error on the table's data, and against the best baseline at the worst size."""
    rows = found["table"]
    forest = chosen(rows, controller=study.roles.forest)
    full = forest[-1]
    tasks = {f"{task}_mm": pm(n["rms_mm"]) for task, n in full["tasks"].items()}
    ci = {"ci95": half(full["rms_mm"]), "seeds": len(full["rms_mm"]["each"])}
    samples = {"samples": full["samples"]["mean"]}
    yield Figure("forest_rms_mm", full["rms_mm"]["mean"], "mm", {**ci, **samples, **tasks})
    nre = {"ci95": half(full["nre"]), "mse_m2": full["mse_m2"]["mean"]}
    yield Figure("forest_nre", full["nre"]["mean"], "1", nre)
    ratios = []
    baselines = [n for n, c in study.controllers.items() if c.baseline]
    for row in forest:
        rivals = [r for r in chosen(rows, share=row["share"]) if r["controller"] in baselines]
        if not rivals:
            return
        best = min(rivals, key=lambda r: float(r["rms_mm"]["mean"]))
        each = number(
            a / b for a, b in zip(row["rms_mm"]["each"], best["rms_mm"]["each"], strict=True)
        )
        ratios.append((row["rms_mm"]["mean"] / best["rms_mm"]["mean"], each, row["share"], best))
    worst = max(ratios, key=lambda r: r[0])
    by_size = {f"at_{share:.0%}": f"{v:.2f} ({best['controller']})" for v, _, share, best in ratios}
    detail = {"ci95": half(worst[1]), "best": worst[3]["controller"], **by_size}
    yield Figure("forest_vs_best_baseline", worst[0], "ratio", detail)


def penalty(found: Rows) -> Iterable[Figure]:
    """(joint - single) / single of the RMS, mean over tasks, same number of samples per task."""
    rows = found["joint"]
    if not rows:
        return
    each = mean_over(rows, "relative")
    detail = {
        "ci95": half(each),
        "of_mean_square": mean_over(rows, "relative_mse")["mean"],
        "same_total_samples": mean_over(rows, "relative_own")["mean"],
        **{row["task"]: pm(row["relative"], 3) for row in rows},
    }
    yield Figure("multitask_penalty", each["mean"], "1", detail)


def iterations(study: Study, found: Rows) -> Iterable[Figure]:
    """Closed-loop error after all iterations over that after one, mean over tasks."""
    name = study.roles.rebuilt
    alone = [r for r in found["live"] if r["task"] != "sequence"]
    one = mean_over(chosen(alone, controller=f"{name}_1"), "mean_mm")
    many = mean_over(chosen(alone, controller=f"{name}_n"), "mean_mm")
    each = number(a / b for a, b in zip(many["each"], one["each"], strict=True))
    expert = mean_over(chosen(alone, controller="expert"), "mean_mm")
    detail = {
        "ci95": half(each),
        "one_mm": pm(one),
        "all_mm": pm(many),
        "expert_mm": pm(expert),
        "iterations": len(found["dagger"][name]["iterations"]),
    }
    cloned = chosen(alone, controller=f"cloned_{study.roles.forest}")
    if cloned:
        detail["cloned_on_the_table_s_data_mm"] = pm(mean_over(cloned, "mean_mm"))
    yield Figure("iterations_20_vs_1", many["mean"] / one["mean"], "ratio", detail)


def unseen(study: Study, found: Rows) -> Iterable[Figure]:
    """Growth of the RMS at the named strength of the worst family that was never trained on."""
    families = [name for name, s in study.series.items() if s.unseen]
    robust = _levels(study, found, study.roles.robust, families, study.roles.unseen_level)
    if not robust:
        return
    worst = max(robust, key=lambda r: float(r["growth"]["mean"]))
    plain = _levels(study, found, study.roles.table, families, study.roles.unseen_level)
    detail = {
        "ci95": half(worst["growth"]),
        "worst": worst["series"],
        "rms_mm": pm(worst["rms_mm"]),
        **{r["series"]: pm(r["growth"], 2) for r in robust},
        **{f"{r['series']}_trained_on_{study.roles.table}": pm(r["growth"], 2) for r in plain},
    }
    yield Figure("unseen_noise_growth", worst["growth"]["mean"], "1", detail)


def occlusion(study: Study, found: Rows) -> Iterable[Figure]:
    """Growth of the RMS when the named share of the cloth is hidden."""
    level, series = study.roles.occlusion_level, [study.roles.occlusion]
    robust = _levels(study, found, study.roles.robust, series, level)
    plain = _levels(study, found, study.roles.table, series, level)
    if robust:
        detail = {"ci95": half(robust[0]["growth"]), "rms_mm": pm(robust[0]["rms_mm"])}
        for row in plain:
            detail[f"trained_on_{study.roles.table}"] = pm(row["growth"], 2)
            detail[f"trained_on_{study.roles.table}_rms_mm"] = pm(row["rms_mm"])
        yield Figure("occlusion_15_growth", robust[0]["growth"]["mean"], "1", detail)


def _levels(
    study: Study, found: Rows, regime: str, series: Sequence[str], level: float
) -> list[Rows]:
    rows = chosen(found["conditions"], regime=regime, controller=study.roles.forest, level=level)
    return [row for row in rows if row["series"] in series]


def swap(study: Study, found: Rows) -> Iterable[Figure]:
    """Error in the other simulator over the error in the own one, both ways, both trainings."""
    roles = study.roles
    simulators = [name for name, s in study.series.items() if s.kind == "simulator"]
    if roles.other_simulator not in simulators or len(simulators) != 2:
        return
    other = roles.other_simulator
    own = next(name for name in simulators if name != other)
    ratios = {}
    for regime, home, away in (
        (roles.robust, own, other),
        (roles.table, own, other),
        (roles.swapped_robust, other, own),
        (roles.swapped, other, own),
    ):
        tried = {
            row["series"]: row["rms_mm"]
            for row in chosen(found["conditions"], regime=regime, controller=roles.forest)
        }
        if home in tried and away in tried:
            pairs = zip(tried[away]["each"], tried[home]["each"], strict=True)
            each = number(a / b for a, b in pairs)
            ratio = tried[away]["mean"] / tried[home]["mean"]
            ratios[regime] = (ratio, each, tried[home], tried[away])
    if roles.robust not in ratios:
        return
    value, each, home_mm, away_mm = ratios[roles.robust]
    detail = {"ci95": half(each), "own_mm": pm(home_mm), "other_mm": pm(away_mm)}
    for regime, (ratio, _, home_mm, away_mm) in ratios.items():
        detail[f"trained_on_{regime}"] = f"{ratio:.2f} ({pm(home_mm)} -> {pm(away_mm)} mm)"
    yield Figure("sim_to_sim_ratio", value, "ratio", detail)


def leaves(study: Study, found: Rows) -> Iterable[Figure]:
    """Change of the number of leaves over the last three iterations."""
    rows = found["dagger"][study.roles.rebuilt]["iterations"]
    if not all("leaves" in row for row in rows):
        return
    last, before = rows[-1]["leaves"], rows[max(0, len(rows) - 4)]["leaves"]
    each = number(abs(a / b - 1.0) for a, b in zip(last["each"], before["each"], strict=True))
    detail = {"ci95": half(each), "leaves": last["mean"], "iterations": len(rows)}
    yield Figure("leaf_growth_last3", each["mean"], "1", detail)


def trust(study: Study, found: Rows) -> Iterable[Figure]:
    """Least area under the ROC curve over the kinds of strange pictures."""
    rows = chosen(found["strange"], regime=study.roles.robust, controller=study.roles.forest)
    plain = chosen(found["strange"], regime=study.roles.table, controller=study.roles.forest)
    if rows:
        worst = min(rows, key=lambda r: float(r["auroc"]["mean"]))
        detail = {"ci95": half(worst["auroc"]), "worst": worst["case"]}
        detail |= {row["case"]: pm(row["auroc"], 3) for row in rows}
        detail |= {f"{r['case']}_trained_on_{study.roles.table}": pm(r["auroc"], 3) for r in plain}
        yield Figure("ood_auroc", worst["auroc"]["mean"], "1", detail)


def mean_over(rows: Sequence[Rows], key: str) -> dict[str, Any]:
    """`number` of the mean over rows (tasks), seed by seed."""
    each = np.array([row[key]["each"] for row in rows])
    return number(each.mean(axis=0))


def half(of: Rows) -> Any:
    """Half-width of the 95 % interval; words where one seed gives none."""
    return "one seed" if of["half"] is None else float(of["half"])


def pm(of: Rows, digits: int = 1) -> str:
    """Mean ± half-width as text."""
    mean = f"{of['mean']:.{digits}f}"
    return mean if of["half"] is None else f"{mean} ± {of['half']:.{digits}f}"
