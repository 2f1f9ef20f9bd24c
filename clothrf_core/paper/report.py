"""The report of a study: Markdown, one self-contained HTML page, a CSV a table, PNG and SVG."""

from __future__ import annotations

import base64
import html
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np

from clothrf_core import plots
from clothrf_core.files import atomic_write, csv_bytes, json_bytes, read_json
from clothrf_core.paper import data, pictures, results, tables, words
from clothrf_core.paper.data import Workspace
from clothrf_core.paper.study import Study
from clothrf_core.provider import Figure
from clothrf_core.report import STYLE, html_table


@dataclass(frozen=True, slots=True)
class Part:
    """A section of the page.

    Attributes:
        head: its heading.
        text: paragraphs.
        table: file name and rows; None = none.
        picture: file name, the figure; None = none.
    """

    head: str
    text: Sequence[str] = ()
    table: tuple[str, list[list[str]]] | None = None
    picture: tuple[str, Any] | None = None


def write_report(space: Workspace, found: Mapping[str, Any], made: Sequence[Figure]) -> None:
    """Write ``REPORT.md``, ``report.html``, ``tables/*.csv``, ``plots/*`` and ``figures.json``."""
    out = space.out
    for folder in ("tables", "plots"):
        (out / folder).mkdir(exist_ok=True)
    parts = page(space.study, found, made, results.seconds(space, found["missing"]))
    atomic_write(out / "tables" / "long.csv", csv_bytes(tables.long(found)))
    about = heading(space)
    markdown, page_parts = [f"# {about[0]}", about[1]], [_head(about)]
    for part in parts:
        drawn = pictures.files(part.picture[1]) if part.picture else None
        if part.picture and drawn:
            for drawing, ending in zip(drawn, ("png", "svg"), strict=True):
                atomic_write(out / "plots" / f"{part.picture[0]}.{ending}", drawing)
        if part.table:
            atomic_write(out / "tables" / f"{part.table[0]}.csv", csv_bytes(part.table[1]))
        markdown.append(_markdown(part))
        page_parts.append(_html(part, drawn[0] if drawn else b""))
    atomic_write(out / "REPORT.md", ("\n\n".join(markdown) + "\n").encode())
    atomic_write(out / "report.html", "\n".join([*page_parts, "</html>"]).encode())
    atomic_write(
        out / "figures.json",
        json_bytes({f.name: {"value": f.value, "unit": f.unit, **f.detail} for f in made}),
    )


def page(
    study: Study, found: Mapping[str, Any], made: Sequence[Figure], spent: Sequence[Any]
) -> list[Part]:
    """The sections, in order; those without data are left out."""
    parts = [
        Part("Which controller to trust", [f"- {line}" for line in words.advice(study, found)]),
        Part("Figures", table=("figures", words.figure_rows(made))),
        Part(
            "Error against the amount of data, mm",
            [words.CLONED],
            ("rms_mm", tables.errors(study, found, "rms_mm", 1)),
            ("learning", pictures.learning(study, found)),
        ),
        Part("The same as NRE", table=("nre", tables.errors(study, found, "nre", 4))),
        Part(
            "Beside the paper's printed numbers",
            [words.RESERVATIONS],
            ("printed", tables.printed(study, found)),
        ),
        Part(
            "Leaves against the amount of data",
            [
                "The paper expects the number of leaves to converge. With its stopping rule, an "
                "impurity decrease below 1e-4, it cannot at these sizes: parting two samples of "
                "different label gains more than that."
            ],
            ("leaves", tables.leaves(study, found)),
        ),
        Part("By task", table=("by_task", tables.by_task(study, found))),
    ]
    if found["dagger"]:
        parts.append(
            Part(
                "DAgger: with and without building the forest anew",
                ["Judged on the roll-outs of the table above, which no run has seen."],
                ("dagger", tables.dagger(study, found)),
                ("dagger", pictures.dagger(study, found)),
            )
        )
    if found["live"]:
        parts.append(
            Part(
                "Closed loop under noise",
                [
                    "Mean distance of the grippers from x* while the hands visit random targets; "
                    "'sequence': the task changes every few seconds of the episode.",
                ],
                ("live", tables.live(study, found)),
                ("live", pictures.live(study, found)),
            )
        )
    if found["joint"]:
        parts.append(
            Part(
                "One forest for all tasks, or one for each",
                [
                    "Relative error = (joint - alone) / alone, on the same unseen rows. Every "
                    "state is labelled by all experts, so with the same states both have the same "
                    "number of samples per task. By the same total, each forest alone gets only "
                    "the states that its own expert led.",
                ],
                ("joint", tables.joint(found)),
                ("joint", pictures.joint(found)),
            )
        )
    parts += _hard(study, found)
    if found["strange"]:
        parts.append(
            Part(
                "Pictures that should not be trusted",
                ["Chance that a normal unseen picture is trusted more than a strange one (AUROC)."],
                ("strange", tables.strange(study, found)),
            )
        )
    if len(found["confidence"]) > 1:
        rows = [[f"{c:.2f}", f"{rms:.1f}", f"{n:.0f}"] for c, rms, n in found["confidence"]]
        parts.append(
            Part(
                "What the forest's confidence is worth",
                ["Answers on unseen roll-outs by what the forest said of them (first seed)."],
                ("confidence", [["confidence", "RMS, mm", "answers"], *rows]),
                ("confidence", plots.confidence(np.array(found["confidence"]))),
            )
        )
    parts.append(Part("Time (varies from run to run)", table=("times", tables.times(study, spent))))
    return parts


def _hard(study: Study, found: Mapping[str, Any]) -> list[Part]:
    heads = {
        "noise": "Noise, also of sensors never trained on",
        "occlusion": "Things between camera and cloth",
        "hands": "Trembling hands",
        "simulator": "Another simulator",
    }
    parts = []
    for kind, head in heads.items():
        rows = tables.conditions(study, found, kind)
        if len(rows) < 2:
            continue
        drawn = (kind, pictures.hard(study, found, kind)) if kind != "simulator" else None
        parts.append(Part(head, table=(kind, rows), picture=drawn))
    return parts


def heading(space: Workspace) -> tuple[str, str]:
    """Title, and what was measured where."""
    about = read_json(space.out / "versions.json")
    size = space.size
    first = {purpose: data.seed_of(purpose, 0) for purpose in data.PURPOSES}
    return "The paper, measured again", (
        f"{size.seeds} seed{'s' if size.seeds > 1 else ''}, "
        f"{size.rollouts * size.steps:,} training samples in {size.rollouts} roll-outs, "
        f"{size.test_rollouts} unseen roll-outs, DAgger {size.iterations} iterations. ± is the "
        f"95 % interval of the mean over seeds. Seeds of training count from {first['train']}, of "
        f"tests from {first['test']}, of hard conditions from {first['condition']}, of closed "
        f"loops from {first['episode']}: nothing is judged on what it learnt from or was chosen "
        f"on. {about['machine']}, Python {about['python']}, started {about['started']}."
    )


def _head(about: tuple[str, str]) -> str:
    title, line = map(html.escape, about)
    return (
        f"<!doctype html><html lang=en><meta charset=utf-8><title>{title}</title>"
        f"<style>{STYLE}</style><h1>{title}</h1><p class=note>{line}</p>"
    )


def _markdown(part: Part) -> str:
    blocks = [f"## {part.head}"]
    if part.text:
        blocks.append("\n".join(part.text))
    if part.picture:
        blocks.append(f"![{part.head}](plots/{part.picture[0]}.png)")
    if part.table:
        head, *body = part.table[1]
        lines = ["| " + " | ".join(head) + " |", "|---" * len(head) + "|"]
        lines += ["| " + " | ".join(row) + " |" for row in body]
        blocks.append("\n".join(lines))
    return "\n\n".join(blocks)


def _html(part: Part, png: bytes) -> str:
    blocks = [f"<h2>{html.escape(part.head)}</h2>"]
    if part.text and part.text[0].startswith("- "):
        items = "".join(f"<li>{html.escape(line[2:])}</li>" for line in part.text)
        blocks.append(f"<ul>{items}</ul>")
    else:
        blocks += [f"<p>{html.escape(line)}</p>" for line in part.text]
    if png:
        uri = f"data:image/png;base64,{base64.b64encode(png).decode()}"
        blocks.append(f"<figure><img src='{uri}' alt='{html.escape(part.head)}'></figure>")
    if part.table:
        blocks.append(html_table(part.table[1]))
    return "\n".join(blocks)
