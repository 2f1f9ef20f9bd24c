"""What the commands show: bars with time left, tables, and the long actions behind them."""

from __future__ import annotations

from collections.abc import Callable, Iterator, Mapping
from contextlib import contextmanager
from pathlib import Path
from typing import Any

from rich.console import Console
from rich.markup import escape
from rich.progress import (
    BarColumn,
    MofNCompleteColumn,
    Progress,
    TaskID,
    TaskProgressColumn,
    TextColumn,
    TimeElapsedColumn,
    TimeRemainingColumn,
)
from rich.table import Table

from clothrf_core.registry import Registry

console = Console()


def train_run(
    path: Path,
    out: Path,
    *,
    resume: bool,
    overrides: dict[str, Any] | None,
    data: Path | None = None,
) -> Any:
    """Train (or go on) with a bar and a line an iteration; returns the `RunFolder`.

    With `data` nothing is simulated: the policy is fitted to that data set alone.
    """
    from clothrf_core import compose, config, imitation
    from clothrf_core.dataset import Dataset
    from clothrf_core.run_folder import RunFolder

    registry = Registry.installed()
    resolved = config.load(path, registry, overrides)
    given = None if data is None else Dataset.open(data)
    run = RunFolder.start(out, resolved, resume=resume)
    experiment = resolved.experiment
    done = len(run.metrics())
    left = (experiment.training.iterations - done) * experiment.training.rollouts
    with progress_bar() as bar:
        total = 1 if given else left + experiment.evaluation.rollouts
        row = bar.add_task("roll-outs" if given is None else "fit", total=total)

        class Shown:
            def advance(self, what: str) -> None:
                bar.advance(row)

            def finished(self, record: dict[str, Any]) -> None:
                bar.console.print(
                    f"iteration {record['iteration']:2d}  beta {record['beta']:.2f}  "
                    f"{record['samples']:6d} samples  held out {record['rms_mm']:6.1f} mm  "
                    f"NRE {record['nre']:.4f}  leaves {record.get('leaves', 0):.0f}",
                    highlight=False,
                )

        if given is None:
            imitation.dagger(run, registry, Shown())
        else:
            imitation.clone(run, registry, given, Shown())
    if given is not None and compose.extractor(resolved, registry).names != given.names:
        console.print(
            f"[yellow]note[/yellow] {data} has other features than features.plugin = "
            f"'{resolved.components['features'].plugin}' makes: 'clothrf run' will refuse this "
            "policy",
            highlight=False,
        )
    return run


def evaluate_run(run: Any, seeds: int | None) -> None:
    """Closed loop with a bar, printed as a table."""
    from clothrf_core.closed_loop import closed_loop
    from clothrf_core.report import closed_loop_rows

    with progress_bar() as bar:
        row = bar.add_task("episodes", total=None)

        def plan(total: int) -> None:
            bar.update(row, total=total)

        table = closed_loop(run, Registry.installed(), seeds, plan, lambda: bar.advance(row))
    print_rows(closed_loop_rows(table))


def draw_run(run: Any, *, film: bool = True) -> None:
    """Write the report, with pictures and a film if asked for."""
    from clothrf_core.gallery import gallery
    from clothrf_core.report import write_report

    if not film:
        write_report(run)
        return
    with progress_bar() as bar:
        row = bar.add_task("pictures", total=None)
        pictures = gallery(
            run, Registry.installed(), lambda n: bar.update(row, total=n), lambda: bar.advance(row)
        )
    write_report(run, pictures)


def progress_bar() -> Progress:
    """A bar with count, time passed and time left."""
    return Progress(
        TextColumn("{task.description}"),
        BarColumn(),
        MofNCompleteColumn(),
        TimeElapsedColumn(),
        TextColumn("left"),
        TimeRemainingColumn(),
        console=console,
    )


@contextmanager
def work_bar() -> Iterator[tuple[Callable[[float], None], Callable[[str, float], None]]]:
    """A line that shows what was done last, how far it is, and the time left.

    Gives two functions, which a measurement without a plan never calls: one takes the work ahead
    in rough seconds, the other what is done and how much of it that was.
    """
    bar = Progress(
        BarColumn(bar_width=24),
        TaskProgressColumn(),
        TimeElapsedColumn(),
        TextColumn("left"),
        TimeRemainingColumn(),
        TextColumn("{task.description}", markup=False),
        console=console,
    )
    rows: list[TaskID] = []
    said = -1

    def plan(seconds: float) -> None:
        if console.is_terminal:
            bar.start()
        rows.append(bar.add_task("", total=seconds))

    def done(what: str, seconds: float) -> None:
        nonlocal said
        bar.update(rows[-1], advance=seconds, description=what)
        task = bar.tasks[-1]
        share = int(task.percentage)
        if not console.is_terminal and share // 5 > said // 5:  # in a file: a line now and then
            left = task.time_remaining
            hint = "" if left is None else f", about {left / 60.0:.0f} min left"
            console.print(f"{share} %{hint}: {what}", highlight=False, markup=False)
            said = share

    try:
        yield plan, done
    finally:
        bar.stop()


def print_figures(written: Mapping[str, Any]) -> None:
    """What `clothrf bench` found, and what it could not measure."""
    table = Table(box=None, header_style="bold")
    for head in ("figure", "value", "unit", "detail"):
        table.add_column(head, overflow="fold")
    for name, figure in written["figures"].items():
        detail = ", ".join(f"{k} {short(v)}" for k, v in figure["detail"].items())
        table.add_row(name, short(figure["value"]), figure["unit"], escape(detail))
    console.print(f"[bold]{written['machine']['name']}[/bold]")
    console.print(table)
    for name, reason in written["skipped"].items():
        console.print(f"[yellow]skipped[/yellow] {name}: {escape(reason)}", highlight=False)


def print_rows(rows: list[list[str]]) -> None:
    """A table whose first row is its header."""
    table = Table(box=None, header_style="bold")
    for i, head in enumerate(rows[0]):
        table.add_column(head, justify="left" if i == 0 else "right")
    for row in rows[1:]:
        table.add_row(*row)
    console.print(table)


def short(value: Any) -> str:
    """Four digits of a float; anything else as it is."""
    return f"{value:.4g}" if isinstance(value, float) else str(value)
