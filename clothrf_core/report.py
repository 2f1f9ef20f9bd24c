"""The report of a run: plots as PNG, numbers as tables, all in one self-contained HTML page."""

from __future__ import annotations

import base64
import html
from collections.abc import Mapping, Sequence
from typing import Any

from clothrf_core import plots
from clothrf_core.files import atomic_write, read_json
from clothrf_core.run_folder import RunFolder

STYLE = """
body{font:15px/1.5 system-ui,sans-serif;color:#22262b;max-width:60rem;
margin:2rem auto;padding:0 1rem}
h1{font-size:1.6rem;margin-bottom:.2rem}h2{font-size:1.15rem;margin-top:2rem}
table{border-collapse:collapse;margin:.6rem 0}td,th{padding:.25rem .8rem;text-align:right;
border-bottom:1px solid #e3e6e8}th{font-weight:600}td:first-child,th:first-child{text-align:left}
img{max-width:100%}pre{background:#f4f6f7;padding:.8rem;overflow:auto;font-size:12px}
.note{color:#5c656d}figure{margin:.8rem 0}figcaption{color:#5c656d;font-size:13px}
"""


def write_report(run: RunFolder, pictures: Mapping[str, tuple[bytes, str]] | None = None) -> None:
    """Write ``plots/*.png`` and ``report.html``.

    Args:
        run: a run with at least one finished iteration.
        pictures: file name -> (PNG or GIF bytes, caption), shown first.
    """
    records = run.metrics()
    evaluation = run.evaluation()
    folder = run.path / "plots"
    folder.mkdir(exist_ok=True)
    shown: list[tuple[str, bytes, str]] = []
    for name, (data, caption) in (pictures or {}).items():
        atomic_write(folder / name, data)
        shown.append((name, data, caption))
    figures = [
        (
            "convergence.png",
            plots.png(plots.convergence(records)),
            "Error on roll-outs that were never trained on, and the size of the forest.",
        )
    ]
    if evaluation.get("closed_loop"):
        figures.append(
            (
                "closed_loop.png",
                plots.png(plots.closed_loop(evaluation["closed_loop"])),
                "Mean distance of the grippers from x* while the hands visit random targets; "
                "bars: 95 % confidence of the mean.",
            )
        )
    for name, data, _ in figures:
        atomic_write(folder / name, data)
    page = _page(run, records, evaluation, [*shown, *figures])
    atomic_write(run.path / "report.html", page.encode())


def table_text(rows: Sequence[Mapping[str, Any]], columns: Mapping[str, str]) -> list[list[str]]:
    """Header and rows as strings; `columns` maps a key to ``"heading|format"``."""
    heads = [spec.split("|")[0] for spec in columns.values()]
    body = []
    for row in rows:
        line = []
        for key, spec in columns.items():
            form = spec.split("|")[1] if "|" in spec else ""
            value = row.get(key, "")
            line.append(format(value, form) if form and value != "" else str(value))
        body.append(line)
    return [heads, *body]


def convergence_rows(records: Sequence[Mapping[str, Any]]) -> list[list[str]]:
    """The convergence table: iteration, beta, samples, leaves, error."""
    columns = {
        "iteration": "iteration",
        "beta": "beta|.3f",
        "samples": "samples",
        "rms_mm": "RMS, mm|.1f",
        "nre": "NRE|.4f",
    }
    if records and "leaves" in records[0]:
        columns["leaves"] = "leaves|.0f"
    return table_text(records, columns)


def closed_loop_rows(table: Sequence[Mapping[str, Any]]) -> list[list[str]]:
    """The closed-loop table."""
    return table_text(
        table,
        {
            "controller": "controller",
            "task": "task",
            "mean_mm": "mean grasp error, mm|.1f",
            "half_mm": "± (95 %)|.1f",
            "p95_mm": "95th percentile, mm|.1f",
            "seeds": "seeds",
        },
    )


def _page(
    run: RunFolder,
    records: Sequence[Mapping[str, Any]],
    evaluation: Mapping[str, Any],
    pictures: Sequence[tuple[str, bytes, str]],
) -> str:
    versions = read_json(run.path / "versions.json")
    best = min(records, key=lambda r: (r["rms_mm"], r["iteration"]))
    parts = [
        f"<!doctype html><html lang=en><meta charset=utf-8><title>clothrf: {run.path.name}</title>",
        f"<style>{STYLE}</style><h1>{html.escape(run.path.name)}</h1>",
        f"<p class=note>{html.escape(versions['started'])} · "
        f"{html.escape(versions['machine'])} · "
        f"Python {html.escape(versions['python'])}</p>",
        f"<p>Best policy: iteration {best['iteration']} with {best['samples']} samples; "
        f"held out by roll-out <b>{best['rms_mm']:.1f} mm</b> RMS per coordinate, "
        f"NRE {best['nre']:.4f}.</p>",
    ]
    for name, data, caption in pictures:
        kind = "gif" if name.endswith(".gif") else "png"
        uri = f"data:image/{kind};base64,{base64.b64encode(data).decode()}"
        parts.append(
            f"<figure><img src='{uri}' alt='{html.escape(name)}'>"
            f"<figcaption>{html.escape(caption)}</figcaption></figure>"
        )
    if evaluation.get("closed_loop"):
        parts += ["<h2>Closed loop</h2>", html_table(closed_loop_rows(evaluation["closed_loop"]))]
    per_task = [{"task": task, **numbers} for task, numbers in best["tasks"].items()]
    columns = {"task": "task", "rms_mm": "RMS, mm|.1f", "mse_m2": "MSE, m²|.2e", "nre": "NRE|.4f"}
    parts += ["<h2>Held-out error by task</h2>", html_table(table_text(per_task, columns))]
    parts += ["<h2>DAgger iterations</h2>", html_table(convergence_rows(records))]
    text = html.escape(run.experiment.read_text())
    parts.append(
        f"<h2>Configuration</h2><details><summary>experiment.toml</summary><pre>{text}</pre>"
        "</details>"
    )
    packages = ", ".join(f"{k} {v}" for k, v in versions["packages"].items())
    parts.append(f"<p class=note>{html.escape(packages)}</p></html>")
    return "\n".join(parts)


def html_table(rows: Sequence[Sequence[str]]) -> str:
    """A table whose first row is its header."""
    head, *body = rows
    lines = ["<table><tr>" + "".join(f"<th>{html.escape(c)}</th>" for c in head) + "</tr>"]
    lines += ["<tr>" + "".join(f"<td>{html.escape(c)}</td>" for c in row) + "</tr>" for row in body]
    return "".join(lines) + "</table>"
