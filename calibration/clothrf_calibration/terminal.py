"""What the user sees in the terminal: bars, tables, lines and warnings."""

from __future__ import annotations

import sys
from collections.abc import Iterable, Iterator
from pathlib import Path
from typing import Any

import numpy as np
from rich.console import Console, Group
from rich.progress import BarColumn, MofNCompleteColumn, Progress, TextColumn, TimeElapsedColumn
from rich.table import Table
from rich.text import Text

from clothrf_calibration.collect import Progress as CollectProgress
from clothrf_calibration.coverage import meter


def guidance(state: CollectProgress) -> Group:
    """Coverage so far and what to do next."""
    lines = [Text(f"{state.kept} of {state.wanted} pictures   {state.last}", style="bold")]
    if state.seen is not None:
        lines += [Text("  " + row, style="green") for row in meter(state.seen.cells)]
        lines.append(
            Text(f"  covered {100 * state.seen.share:.0f} %, tilt spread {state.seen.spread:.0f}°")
        )
    lines += [Text(f"  -> {line}", style="yellow") for line in state.advice[:3]]
    return Group(*lines)


def show_intrinsics(tables: dict[str, Any], out: Path) -> None:
    """The solved lens, its quality, and every warning."""
    u, r = tables["uncertainty"], tables["residuals"]
    c = tables["camera"]
    values = [c["K"][0][0], c["K"][1][1], c["K"][0][2], c["K"][1][2], *c["distortion"]]
    table = Table("", "value", "one sd")
    for name, value, sd in zip(u["names"], values, u["sd"], strict=True):
        table.add_row(name, f"{value:.5g}" if abs(value) < 10 else f"{value:.2f}", f"{sd:.2g}")
    console().print(table)
    held = (
        f", held out {r['held_out_px']:.3f} ± {r['held_out_spread_px']:.3f} px"
        if "held_out_px" in r else ""
    )  # fmt: skip
    say(
        f"residual {r['rms_px']:.3f} px over {r['corners'] - r['rejected']} corners "
        f"({r['rejected']} rejected){held}; projections uncertain by "
        f"{u['projection_mean_px']:.2f} px on average, {u['projection_worst_px']:.2f} px at worst"
    )
    for name, why in tables["dropped"].items():
        warn(f"{name} was left out: {why}")
    for group in ("intrinsics", "uncertainty"):
        for line in tables["warnings"][group]:
            warn(line)
    say(f"wrote {out}")


def show_extrinsics(tables: dict[str, Any], out: Path) -> None:
    """The solved pose, its quality, and every warning."""
    e = tables["extrinsics"]
    for name in (k for k in e if k.startswith("T_")):
        say(f"{name} =\n{np.array2string(np.array(e[name]), precision=6, suppress_small=True)}")
    fit = f"{e['rms_px']:.3f} px" if "rms_px" in e else f"{e['fit_mm']:.2f} mm"
    say(f"camera pose +- {e['sd_mm']:.2f} mm, {e['sd_deg']:.4f} degrees; fit {fit}")
    if "held_out_mm" in e:
        say(
            f"held out: {e['held_out_px']:.3f} px, {e['held_out_mm']:.2f} ± "
            f"{e['held_out_spread_mm']:.2f} mm, {e['held_out_deg']:.3f} degrees"
        )
    for line in tables["warnings"]["extrinsics"]:
        warn(line)
    say(f"wrote {out}")


def progress_bar() -> Progress:
    """A bar with time elapsed."""
    return Progress(
        TextColumn("{task.description}"), BarColumn(), MofNCompleteColumn(), TimeElapsedColumn(),
        console=console(),
    )  # fmt: skip


def track(paths: Iterable[Path], count: int) -> Iterator[Path]:
    """Bar over pictures."""
    with progress_bar() as bar:
        yield from bar.track(paths, total=count, description="finding the board")


def tracked(names: list[str], what: str) -> Iterator[str]:
    """Bar over anything named."""
    with progress_bar() as bar:
        yield from bar.track(names, total=len(names), description=what)


def command_line() -> str:
    """What was typed."""
    return " ".join(["clothrf", *sys.argv[1:]])


def console() -> Console:
    """Where bars, tables and warnings go."""
    return Console(stderr=True)


def say(text: str) -> None:
    """A line for the user."""
    Console().print(text, markup=False, highlight=False, soft_wrap=True)


def warn(text: str) -> None:
    """A loud line for the user."""
    console().print(f"warning: {text}", style="bold yellow", markup=False, soft_wrap=True)
