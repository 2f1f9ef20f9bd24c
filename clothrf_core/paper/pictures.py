"""The plots of the report, in the style of `clothrf_core.plots`; nothing is written here."""

from __future__ import annotations

import io
from collections.abc import Iterable, Mapping, Sequence
from typing import Any

import numpy as np

from clothrf_core import plots
from clothrf_core.paper.figures import Rows
from clothrf_core.paper.results import chosen
from clothrf_core.paper.study import Study
from clothrf_core.paper.tables import controllers, live_title

FOREST, RIVALS = plots.ORANGE, ("#1f6f8b", "#5b8c5a", "#8a5a8c", "#b08d3c", "#4a6fb0", "#a14f4f")
DASHES = ("-", "--", ":")
Look = tuple[str, str]  # colour, dashes
CLIP = 100.0  # mm; what is beyond does not belong on the picture


def learning(study: Study, found: Rows) -> Any:
    """Error against the share of the data, one line a controller."""
    figure, axis = plots.house_axes(8.6, 4.6)
    palette = _palette(study, found)
    for name in controllers(study, found):
        rows = chosen(found["table"], controller=name)
        mean = np.array([r["rms_mm"]["mean"] for r in rows])
        if mean.min() > CLIP or len(mean) < 2:
            continue
        shares, title = [100.0 * r["share"] for r in rows], study.controllers[name].title
        ours = name == study.roles.forest  # sixteen bands on one picture would hide the lines
        _line(axis, shares, [r["rms_mm"] for r in rows], title, palette[name], shade=ours)
    axis.set(xlabel="share of the training data, %", ylabel="held-out RMS per coordinate, mm")
    axis.set_ylim(0, CLIP if axis.get_ylim()[1] > CLIP else None)
    axis.legend(frameon=False, fontsize=7.5, loc="center left", bbox_to_anchor=(1.0, 0.5))
    return figure


def dagger(study: Study, found: Rows) -> Any:
    """Error and leaves after each DAgger iteration."""
    figure, both = plots.house_axes(9.0, 3.6, 2)
    for index, (kind, runs) in enumerate(found["dagger"].items()):
        look = _look(index) if index else (FOREST, "-")
        rows = runs["iterations"]
        x, title = [r["iteration"] for r in rows], study.dagger[kind].title
        _line(both[0], x, [r["rms_mm"] for r in rows], title, look)
        if all("leaves" in r for r in rows):
            _line(both[1], x, [r["leaves"] for r in rows], title, look)
    for axis, label in zip(both, ("RMS on unseen roll-outs, mm", "leaves"), strict=True):
        axis.xaxis.get_major_locator().set_params(integer=True)
        axis.set(xlabel="DAgger iteration", ylabel=label, ylim=(0, None))
    both[0].legend(frameon=False, fontsize=8)
    return figure


def live(study: Study, found: Rows) -> Any:
    """Closed loop under noise: a group of bars a task, a bar a controller."""
    names = list(dict.fromkeys(row["controller"] for row in found["live"]))
    tasks = list(dict.fromkeys(row["task"] for row in found["live"]))
    figure, axis = plots.house_axes(9.0, 3.8)
    width = 0.8 / len(names)
    for i, name in enumerate(names):
        rows = {row["task"]: row["mean_mm"] for row in chosen(found["live"], controller=name)}
        colour = plots.GREY if name == "expert" else FOREST if i == 1 else _look(i - 2)[0]
        place = np.arange(len(tasks)) + (i - 0.5 * (len(names) - 1)) * width
        error = [rows[task]["half"] or 0.0 for task in tasks]
        mean = [rows[task]["mean"] for task in tasks]
        axis.bar(
            place, mean, width, yerr=error, color=colour, capsize=2, label=live_title(study, name)
        )
    axis.set_xticks(range(len(tasks)), tasks)
    axis.set(ylabel="mean distance of the grippers from x*, mm", ylim=(0, None))
    axis.grid(axis="x", visible=False)
    axis.legend(frameon=False, fontsize=7.5, loc="upper left", bbox_to_anchor=(0.0, -0.1), ncols=2)
    return figure


def hard(study: Study, found: Rows, kind: str) -> Any:
    """Error against the strength of every series of one kind, one panel a training regime."""
    rows = [r for r in found["conditions"] if study.series[r["series"]].kind == kind]
    tried = {r["series"] for r in rows}
    names = [
        n for n, s in study.series.items() if s.kind == kind and len(s.levels) > 1 and n in tried
    ]
    regimes = [
        g
        for g in dict.fromkeys(r["regime"] for r in rows)
        if study.regimes[g].only is None and names
    ]
    figure, panels = plots.house_axes(4.6 * max(len(regimes), 1), 3.8, max(len(regimes), 1))
    for axis, regime in zip(np.atleast_1d(panels), regimes, strict=False):
        axis.set_title(f"trained on: {regime}", fontsize=9)
        if kind == "noise":
            _families(axis, study, rows, regime, names)
        else:
            _rivals(axis, study, rows, regime, names)
        axis.set(xlabel=_strength(kind), ylabel="RMS per coordinate, mm", ylim=(0, None))
        axis.legend(frameon=False, fontsize=7.5)
    _same_height(list(np.atleast_1d(panels)))
    return figure


def _families(axis: Any, study: Study, rows: Sequence[Rows], regime: str, names: list[str]) -> None:
    """The forest under each family of noise."""
    mine = chosen(rows, regime=regime, controller=study.roles.forest)
    for index, name in enumerate(names):
        look = _look(index - 1) if index else (FOREST, "-")
        zero = study.series[name].zero
        first = [r for r in mine if r["series"] == zero and r["level"] == 0.0] if zero else []
        series = [*first, *chosen(mine, series=name)]
        if series:
            _line(axis, [r["level"] for r in series], [r["rms_mm"] for r in series], name, look)


def _rivals(axis: Any, study: Study, rows: Sequence[Rows], regime: str, names: list[str]) -> None:
    """All controllers under one kind of difficulty."""
    here = [r for r in chosen(rows, regime=regime) if r["series"] in names]
    for name in dict.fromkeys(r["controller"] for r in here):
        look = _palette(study, {"table": here})[name]
        mine = chosen(here, controller=name)
        title = study.controllers[name].title
        _line(axis, [r["level"] for r in mine], [r["rms_mm"] for r in mine], title, look)


def joint(found: Rows) -> Any:
    """The joint forest beside forests of one task."""
    figure, axis = plots.house_axes(5.4, 3.4)
    kinds = (("joint_mm", "one forest for all tasks", FOREST),
             ("single_mm", "one forest a task, all states", plots.BLUE),
             ("single_own_mm", "one forest a task, its own states", plots.GREY))  # fmt: skip
    for i, (key, label, colour) in enumerate(kinds):
        place = np.arange(len(found["joint"])) + 0.27 * (i - 1)
        mean = [row[key]["mean"] for row in found["joint"]]
        error = [row[key]["half"] or 0.0 for row in found["joint"]]
        axis.bar(place, mean, 0.25, yerr=error, capsize=2, color=colour, label=label)
    axis.set_xticks(range(len(found["joint"])), [row["task"] for row in found["joint"]])
    axis.set(ylabel="held-out RMS, mm", ylim=(0, None))
    axis.grid(axis="x", visible=False)
    axis.legend(frameon=False, fontsize=8, loc="upper left", bbox_to_anchor=(0.0, -0.1))
    return figure


def files(figure: Any) -> tuple[bytes, bytes]:
    """A figure as PNG and SVG; equal figures give equal bytes."""
    buffer = io.BytesIO()
    with plots.fixed_ids():
        figure.savefig(buffer, format="svg", metadata={"Date": None, "Creator": None})
    return plots.png(figure), buffer.getvalue()


def _line(
    axis: Any,
    x: Sequence[float],
    of: Iterable[Rows],
    label: str,
    look: Look,
    *,
    shade: bool = True,
) -> None:
    numbers = list(of)
    colour, dash = look
    mean = np.array([n["mean"] for n in numbers])
    half = np.array([n["half"] or 0.0 for n in numbers])
    width = 2.2 if colour == FOREST else 1.1
    axis.plot(x, mean, dash, marker=".", color=colour, label=label, linewidth=width)
    if shade and half.any():
        axis.fill_between(x, mean - half, mean + half, color=colour, alpha=0.12, linewidth=0)


def _look(index: int) -> Look:
    """Colour and dashes of the rival of this number."""
    return RIVALS[index % len(RIVALS)], DASHES[index // len(RIVALS) % len(DASHES)]


def _palette(study: Study, found: Mapping[str, Any]) -> dict[str, Look]:
    """The forest in its colour, rivals in turn in theirs."""
    names = list(dict.fromkeys(row["controller"] for row in found["table"]))
    rest = [name for name in names if name != study.roles.forest]
    looks = {name: _look(i) for i, name in enumerate(rest)}
    return {**looks, study.roles.forest: (FOREST, "-")}


def _strength(kind: str) -> str:
    return {
        "noise": "strength of the noise",
        "occlusion": "share of the cloth hidden",
        "hands": "standard deviation of the hands over the nominal one",
    }.get(kind, "level")


def _same_height(panels: Sequence[Any]) -> None:
    top = max(axis.get_ylim()[1] for axis in panels)
    for axis in panels:
        axis.set_ylim(0, top)
