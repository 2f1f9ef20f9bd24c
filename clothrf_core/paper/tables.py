"""The tables of the report: a header and rows of text each, in the order of the page."""

from __future__ import annotations

from collections.abc import Iterable, Mapping, Sequence
from typing import Any

from clothrf_core.paper.figures import pm
from clothrf_core.paper.results import MEASURES, chosen
from clothrf_core.paper.study import Study

Rows = Mapping[str, Any]
Table = list[list[str]]


def errors(study: Study, found: Rows, measure: str, digits: int) -> Table:
    """One row a controller, one column a share of the data."""
    shares = sorted({row["share"] for row in found["table"]})
    lines = [["controller", *(f"{share:.0%}" for share in shares)]]
    for name in controllers(study, found):
        rows = {row["share"]: row for row in chosen(found["table"], controller=name)}
        lines.append(
            [
                study.controllers[name].title,
                *(_number(rows[s][measure], digits) if s in rows else "" for s in shares),
            ]
        )
    for name in found["missing"]:
        lines.append([study.controllers[name].title, *(["not installed"] * len(shares))])
    return lines


def long(found: Rows) -> Table:
    """Everything about the table, for a spreadsheet: a row a controller, share, task, measure."""
    lines = [["controller", "share", "samples", "task", "measure", "mean", "ci95", "seeds"]]
    for row in found["table"]:
        for task, numbers in {"all": row, **row["tasks"]}.items():
            for measure in MEASURES:
                of = numbers[measure]
                half = "" if of["half"] is None else f"{of['half']:.6g}"
                start = [row["controller"], f"{row['share']:g}", f"{row['samples']['mean']:g}"]
                rest = [task, measure, f"{of['mean']:.6g}", half, str(len(of["each"]))]
                lines.append(start + rest)
    return lines


def leaves(study: Study, found: Rows) -> Table:
    """Leaves of every forest against the amount of data."""
    shares = sorted({row["share"] for row in found["table"]})
    lines = [["forest", *(f"{share:.0%}" for share in shares)]]
    for name in controllers(study, found):
        rows = {row["share"]: row["leaves"] for row in chosen(found["table"], controller=name)}
        if all(rows.values()):
            cells = [_number(rows.get(share), 0) for share in shares]
            lines.append([study.controllers[name].title, *cells])
    return lines


def printed(study: Study, found: Rows) -> Table:
    """Mean squares per coordinate: what the paper prints, and ours below."""
    shares = sorted({share for row in study.printed.values() for share in row.shares})
    lines = [["mean square per coordinate, m² (the paper names no unit)"]]
    lines[0] += [f"{share:.0%}" for share in shares]
    for printed_row in study.printed.values():
        known = dict(zip(printed_row.shares, printed_row.mse, strict=True))
        lines.append([printed_row.title, *(_small(known.get(s)) for s in shares)])
    for name in controllers(study, found):
        rows = {row["share"]: row for row in chosen(found["table"], controller=name)}
        lines.append(
            [
                study.controllers[name].title,
                *(_small(rows[s]["mse_m2"]["mean"]) if s in rows else "" for s in shares),
            ]
        )
    return lines


def by_task(study: Study, found: Rows) -> Table:
    """RMS and NRE of every task with all of the data."""
    tasks = list(found["table"][0]["tasks"])
    heads = [f"{task}, {what}" for task in tasks for what in ("mm", "NRE")]
    lines = [["controller, all data", *heads]]
    for name in controllers(study, found):
        row = chosen(found["table"], controller=name)[-1]
        cells = []
        for task in tasks:
            cells += [
                _number(row["tasks"][task]["rms_mm"], 1),
                _number(row["tasks"][task]["nre"], 3),
            ]
        lines.append([study.controllers[name].title, *cells])
    return lines


def conditions(study: Study, found: Rows, kind: str) -> Table:
    """RMS under every level of the series of one kind, a row a controller and training."""
    rows = [r for r in found["conditions"] if study.series[r["series"]].kind == kind]
    columns = list(dict.fromkeys((r["series"], r["level"]) for r in rows))
    lines = [["controller", "trained on", *(_level(study, *c) for c in columns)]]
    for regime, name in dict.fromkeys((r["regime"], r["controller"]) for r in rows):
        mine = {(r["series"], r["level"]): r for r in chosen(rows, regime=regime, controller=name)}
        cells = [_number(mine[c]["rms_mm"], 1) if c in mine else "" for c in columns]
        lines.append([study.controllers[name].title, regime, *cells])
    return lines


def _level(study: Study, series: str, level: float) -> str:
    one = len(study.series[series].levels) == 1
    return f"{series}, mm" if one else f"{series} {level:g}, mm"


def dagger(study: Study, found: Rows) -> Table:
    """Error and leaves after every iteration, with and without building the forest anew."""
    kinds = list(found["dagger"])
    heads = [f"{kind}, {what}" for kind in kinds for what in ("RMS mm", "leaves")]
    lines = [["iteration", "samples", *heads]]
    first = found["dagger"][kinds[0]]["iterations"] if kinds else []
    for index, row in enumerate(first):
        cells = [str(row["iteration"]), f"{row['samples']['mean']:.0f}"]
        for kind in kinds:
            same = found["dagger"][kind]["iterations"][index]
            cells += [_number(same["rms_mm"], 1), _number(same.get("leaves"), 0)]
        lines.append(cells)
    return lines


def live(study: Study, found: Rows) -> Table:
    """Mean distance of the grippers from x* in closed loop under noise."""
    tasks = list(dict.fromkeys(row["task"] for row in found["live"]))
    lines = [["controller", *(f"{task}, mm" for task in tasks)]]
    for name in dict.fromkeys(row["controller"] for row in found["live"]):
        rows = {row["task"]: row for row in chosen(found["live"], controller=name)}
        cells = [_number(rows[task]["mean_mm"], 1) for task in tasks]
        lines.append([live_title(study, name), *cells])
    return lines


def live_title(study: Study, name: str) -> str:
    """What a controller of the closed loop is."""
    if name == "expert":
        return "the expert, who sees the hands"
    if name.startswith("cloned_"):
        title = study.controllers[name.removeprefix("cloned_")].title
        return f"{title}, cloned from the table's data"
    kind, _, which = name.rpartition("_")
    after = "one iteration" if which == "1" else "all iterations"
    return f"DAgger, {study.dagger[kind].title}, {after}"


def joint(found: Rows) -> Table:
    """The joint forest against one forest a task, by both ways of counting samples."""
    lines = [
        ["task", "joint, mm", "alone, mm", "relative error", "of the mean square",
         "alone on its own states, mm", "relative error (same total)"]
    ]  # fmt: skip
    for row in found["joint"]:
        lines.append(
            [
                row["task"],
                _number(row["joint_mm"], 2),
                _number(row["single_mm"], 2),
                _number(row["relative"], 3),
                _number(row["relative_mse"], 3),
                _number(row["single_own_mm"], 2),
                _number(row["relative_own"], 3),
            ]
        )
    return lines


def strange(study: Study, found: Rows) -> Table:
    """Area under the ROC curve of confidence, normal against strange pictures."""
    cases = list(dict.fromkeys(row["case"] for row in found["strange"]))
    lines = [["controller", "trained on", *(study.strange[case].title for case in cases)]]
    pairs = dict.fromkeys((r["regime"], r["controller"]) for r in found["strange"])
    for regime, name in pairs:
        mine = {r["case"]: r for r in chosen(found["strange"], regime=regime, controller=name)}
        cells = [_number(mine[c]["auroc"], 3) if c in mine else "" for c in cases]
        lines.append([study.controllers[name].title, regime, *cells])
    return lines


def times(study: Study, spent: Sequence[Rows]) -> Table:
    """Seconds of a fit, microseconds of an answer."""
    lines = [["controller", "fit on all data, s", "one answer, µs"]]
    for row in spent:
        title = study.controllers[row["controller"]].title
        lines.append([title, f"{row['fit_s']:.1f}", f"{row['act_us']:.0f}"])
    return lines


def controllers(study: Study, found: Rows) -> Iterable[str]:
    """The controllers of the table, the best with all of the data first."""
    whole = {row["controller"]: row for row in found["table"]}  # the last share wins
    return sorted(whole, key=lambda name: float(whole[name]["rms_mm"]["mean"]))


def _number(of: Rows | None, digits: int) -> str:
    if of is None:
        return ""
    return pm(of, digits) if abs(of["mean"]) < 1e5 else f"{of['mean']:.1e}"


def _small(value: float | None) -> str:
    return (
        "" if value is None else f"{value:.2e}" if value < 1e-3 or value > 1e3 else f"{value:.4f}"
    )
