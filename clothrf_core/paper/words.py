"""What the numbers mean for somebody who has to choose a controller, in plain words."""

from __future__ import annotations

from collections.abc import Iterable, Mapping, Sequence

import numpy as np

from clothrf_core.paper.figures import Rows, mean_over, pm
from clothrf_core.paper.results import chosen
from clothrf_core.paper.study import Study
from clothrf_core.paper.tables import live_title
from clothrf_core.provider import Figure

RESERVATIONS = (
    "The paper prints 0.0038 for its forest and names no unit. As m² it is 62 mm of error per "
    "coordinate, and on a cloth of 0.30 x 0.35 m a constant scores about as well: a small mean "
    "square says nothing until it is divided by the variance of what is wanted (NRE). Its network "
    "is worse than a constant on every cloth of that size, so its table was most likely made with "
    "a larger one. Its linear model is 1e17 and worse below 100 % and 43 times better than its "
    "forest at 100 %: least squares without regularisation on more features than rows, and a last "
    "column that was probably tested on what it was trained on. Its test points were drawn by "
    "frame, ours by whole roll-outs: neighbouring frames are nearly the same picture. Printed and "
    "measured rows stand side by side, but are not the same experiment."
)
CLONED = (
    "All controllers of this table learn from the same states (behaviour cloning: an expert leads, "
    "every second roll-out is pushed off its path), so that only the controllers differ. The runs "
    "further below are DAgger: there the controller's own mistakes choose the states."
)


def advice(study: Study, found: Rows) -> list[str]:
    """Sentences, the most useful first."""
    return [
        *_best(study, found),
        *_few(study, found),
        *_constant(study, found),
        *_live(study, found),
        *_hard(study, found),
        *_missing(study, found),
    ]


def _ranked(study: Study, found: Rows, share: float) -> list[Rows]:
    return sorted(chosen(found["table"], share=share), key=lambda r: float(r["rms_mm"]["mean"]))


def _best(study: Study, found: Rows) -> Iterable[str]:
    shares = sorted({row["share"] for row in found["table"]})
    ranked = _ranked(study, found, shares[-1])
    best, forest = ranked[0], chosen(ranked, controller=study.roles.forest)[0]
    samples = f"{best['samples']['mean']:,.0f}"
    yield (
        f"With {samples} samples the most accurate is {_title(study, best)}: "
        f"{pm(best['rms_mm'])} mm per coordinate on roll-outs nobody trained on."
    )
    if best is not forest:
        place = [r["controller"] for r in ranked].index(study.roles.forest) + 1
        ratio = forest["rms_mm"]["mean"] / best["rms_mm"]["mean"]
        yield (
            f"The default forest is number {place} of {len(ranked)} with "
            f"{pm(forest['rms_mm'])} mm, {100 * (ratio - 1):.0f} % more than the best."
        )
    elif len(ranked) > 1:
        ratio = forest["rms_mm"]["mean"] / ranked[1]["rms_mm"]["mean"]
        yield (
            f"The next best, {_title(study, ranked[1])}, has {pm(ranked[1]['rms_mm'])} mm: the "
            f"forest makes {100 * (1 - ratio):.0f} % less error."
        )


def _few(study: Study, found: Rows) -> Iterable[str]:
    shares = sorted({row["share"] for row in found["table"]})
    if len(shares) > 1:
        first = _ranked(study, found, shares[0])[0]
        yield (
            f"With few data ({first['samples']['mean']:,.0f} samples) trust "
            f"{_title(study, first)}: {pm(first['rms_mm'])} mm."
        )


def _constant(study: Study, found: Rows) -> Iterable[str]:
    shares = sorted({row["share"] for row in found["table"]})
    worst = [r for r in _ranked(study, found, shares[-1]) if abs(r["nre"]["mean"] - 1.0) < 0.05]
    if worst:
        row = worst[0]
        title = _title(study, row)
        yield (
            f"{title[0].upper()}{title[1:]} looks at nothing and has a mean square of only "
            f"{row['mse_m2']['mean']:.4f} m² ({pm(row['rms_mm'], 0)} mm, NRE "
            f"{row['nre']['mean']:.2f}): read NRE or millimetres, never the mean square."
        )


def _live(study: Study, found: Rows) -> Iterable[str]:
    names = dict.fromkeys(row["controller"] for row in found["live"])
    means = {name: mean_over(chosen(found["live"], controller=name), "mean_mm") for name in names}
    expert = means.pop("expert", None)
    if means and expert is not None:
        best = min(means, key=lambda name: float(means[name]["mean"]))
        yield (
            f"In closed loop under noise the best is {live_title(study, best)}: the grippers are "
            f"{pm(means[best])} mm from where they should be, the expert's {pm(expert)} mm (it is "
            "always a little late for moving hands)."
        )


def _hard(study: Study, found: Rows) -> Iterable[str]:
    forest = chosen(found["conditions"], controller=study.roles.forest)
    unseen = [
        r
        for r in forest
        if study.series[r["series"]].unseen and r["level"] == study.roles.unseen_level
    ]
    errors: dict[str, float] = {}
    for regime in (study.roles.table, study.roles.robust):
        mine = [float(r["rms_mm"]["mean"]) for r in chosen(unseen, regime=regime)]
        if mine:
            errors[regime] = float(np.mean(mine))
    if len(errors) == 2:
        better = min(errors, key=lambda name: errors[name])
        yield (
            f"For a sensor that is not the trained one, train with '{better}': under unseen noise "
            f"of strength {study.roles.unseen_level:g} the forest has {errors[better]:.1f} mm, "
            f"against {max(errors.values()):.1f} mm with the other training."
        )
    rivals = [
        r
        for r in chosen(found["conditions"], regime=study.roles.robust)
        if r["series"] == study.roles.occlusion and r["level"] == study.roles.occlusion_level
    ]
    if rivals:
        best = min(rivals, key=lambda r: float(r["rms_mm"]["mean"]))
        yield (
            f"With {study.roles.occlusion_level:.0%} of the cloth hidden the least error has "
            f"{_title(study, best)}: {pm(best['rms_mm'])} mm."
        )


def _missing(study: Study, found: Rows) -> Iterable[str]:
    for name, reason in found["missing"].items():
        yield f"Not measured: {study.controllers[name].title} ({reason})."


def figure_rows(made: Sequence[Figure]) -> list[list[str]]:
    """Name, value, unit and what stands beside it."""
    rows = [["figure", "value", "unit", "beside it"]]
    for figure in made:
        words = ", ".join(f"{k} {_short(v)}" for k, v in figure.detail.items())
        rows.append([figure.name, _short(figure.value), figure.unit, words])
    return rows


def _short(value: object) -> str:
    return f"{value:.4g}" if isinstance(value, float) else str(value)


def _title(study: Study, row: Mapping[str, str]) -> str:
    return study.controllers[row["controller"]].title
