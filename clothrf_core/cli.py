"""The command line: a few lines a command over the library. Nothing else in the core prints."""

from __future__ import annotations

import logging
import sys
from pathlib import Path
from typing import Annotated, Any, Literal

import typer
from rich.console import Console
from rich.logging import RichHandler
from rich.markup import escape
from rich.table import Table

from clothrf_core import __version__
from clothrf_core.console import (
    console,
    draw_run,
    evaluate_run,
    print_figures,
    print_rows,
    progress_bar,
    short,
    train_run,
    work_bar,
)
from clothrf_core.errors import ClothrfError, UnknownPlugin, suggestion
from clothrf_core.registry import KINDS, Registry

app = typer.Typer(
    name="clothrf",
    help="Random-forest controllers for robots that handle cloth.",
    no_args_is_help=True,
    add_completion=False,
    rich_markup_mode="rich",
    pretty_exceptions_enable=False,
)

ConfigPath = Annotated[Path, typer.Argument(help="experiment TOML file")]
RunPath = Annotated[Path, typer.Argument(help="run folder, as written by train")]
Set = Annotated[
    list[str] | None,
    typer.Option("--set", help="override a key, as --set training.iterations=3; repeatable"),
]


@app.callback(invoke_without_command=True)
def _root(
    version: Annotated[bool, typer.Option("--version", help="print the version and exit")] = False,
    verbose: Annotated[bool, typer.Option("--verbose", help="log more")] = False,
) -> None:
    logging.basicConfig(
        level=logging.INFO if verbose else logging.WARNING,
        format="%(message)s",
        handlers=[RichHandler(console=Console(stderr=True), show_path=False, show_time=False)],
    )
    if version:
        console.print(f"clothrf {__version__}")
        raise typer.Exit


@app.command()
def demo(
    out: Annotated[Path, typer.Option(help="folder to write")] = Path("runs/demo"),
    config: Annotated[Path | None, typer.Option(help="another experiment file")] = None,
    resume: Annotated[bool, typer.Option(help="go on with a killed demo")] = False,
) -> None:
    """Train, evaluate in closed loop, and draw the cloth with the controller and the expert."""
    from clothrf_core.locations import shipped

    path = config or shipped("demo.toml")
    if out.exists() and not resume and not (out / "report.html").exists():
        resume = (out / "experiment.toml").exists()
    if (out / "report.html").exists() and not resume:
        out = _free(out)
    run = train_run(path, out, resume=resume, overrides=None)
    evaluate_run(run, None)
    draw_run(run)
    console.print(f"\nPictures, animation and report: [bold]{out / 'report.html'}[/bold]")


@app.command()
def train(
    config: ConfigPath,
    out: Annotated[Path | None, typer.Option(help="run folder; default runs/<config name>")] = None,
    resume: Annotated[bool, typer.Option(help="go on where a killed run stopped")] = False,
    dask: Annotated[
        str | None, typer.Option(help="collect on a Dask cluster: tcp://host:port, or local")
    ] = None,
    workers: Annotated[int | None, typer.Option(help="worker processes", min=1)] = None,
    data: Annotated[
        Path | None, typer.Option(help="learn from this data set alone; nothing is simulated")
    ] = None,
    overrides: Set = None,
) -> None:
    """Train a policy by imitation (DAgger). Example: clothrf train configs/straight.toml."""
    extra: dict[str, Any] = {}
    if dask is not None:
        extra = {"collection.engine": "dask", "collection.address": dask}
    if workers is not None:
        extra["collection.workers"] = workers
    target = out or Path("runs") / config.stem
    changes = {**_overrides(overrides), **extra}
    run = train_run(config, target, resume=resume, overrides=changes, data=data)
    draw_run(run, film=False)
    console.print(f"Policy: {run.best}\nReport: {run.path / 'report.html'}")


@app.command()
def evaluate(
    folder: RunPath,
    seeds: Annotated[int | None, typer.Option(help="episodes a controller", min=2)] = None,
) -> None:
    """Closed loop: the trained policy against its expert over random hand targets."""
    from clothrf_core.run_folder import RunFolder

    run = RunFolder.open(folder)
    evaluate_run(run, seeds)
    draw_run(run)
    console.print(f"Report: {run.path / 'report.html'}")


@app.command()
def predict(
    policy: Annotated[Path, typer.Argument(help="policy folder, as runs/demo/policy")],
    folder: Annotated[Path, typer.Argument(help="*_color.png, *_depth.png and camera.toml")],
    out: Annotated[
        Path | None, typer.Option(help="where to write; default FOLDER/predictions")
    ] = None,
    task: Annotated[list[str] | None, typer.Option(help="task; repeatable; default all")] = None,
    rig: Annotated[Path | None, typer.Option(help="rig file with the real scene's cues")] = None,
    overlays: Annotated[bool, typer.Option(help="draw the targets on the pictures")] = True,
) -> None:
    """Run a trained policy over a folder of real frames: a CSV table and overlays."""
    from clothrf_core.config import read_rig
    from clothrf_core.predict import Prediction, predict_folder

    target = out or folder / "predictions"
    invalid = 0
    with progress_bar() as bar:
        row = bar.add_task("frames", total=None)

        def show(prediction: Prediction) -> None:
            nonlocal invalid
            invalid += not prediction.features.valid
            bar.advance(row)

        count = predict_folder(
            policy,
            folder,
            target,
            Registry.installed(),
            tasks=tuple(task or ()),
            rig=read_rig(rig) if rig else None,
            overlays=overlays,
            on_frame=show,
        )
    console.print(
        f"{count} frames, {invalid} without usable foreground: {target / 'predictions.csv'}"
    )


@app.command()
def run(
    config: ConfigPath,
    policy: Annotated[Path, typer.Option(help="policy folder")] = Path("runs/demo/policy"),
    task: Annotated[str | None, typer.Option(help="default: the policy's first")] = None,
    seconds: Annotated[float | None, typer.Option(help="default: until Ctrl-C", min=0)] = None,
    yes: Annotated[bool, typer.Option("--yes", help="do not ask before moving a robot")] = False,
) -> None:
    """Run a trained policy: camera, features, policy, limits, robot. Ctrl-C stops the arms."""
    import signal

    from clothrf_core import compose, live
    from clothrf_core.config import load

    registry = Registry.installed()
    resolved = load(config, registry)
    trained, _ = compose.open_policy(policy, registry)
    chosen = task or trained.tasks[0]
    mover = resolved.components["robot"].plugin
    if mover != "simulated":
        console.print(f"robot '{mover}', task '{chosen}', rig '{resolved.rig.name}'")
        for key, value in resolved.experiment.limits.model_dump().items():
            console.print(f"  limits.{key} = {value}", highlight=False)
        if not yes:
            typer.confirm("The arms will move. Go on?", abort=True)
    session = live.session(resolved, registry, trained, chosen)
    stop = False

    def interrupted(*_: object) -> None:
        nonlocal stop
        stop = True

    previous = signal.signal(signal.SIGINT, interrupted)
    pulse = live.Pulse()
    errors: list[float] = []
    try:
        with console.status("starting") as line:

            class Shown:
                def on_step(self, _: object) -> None:
                    if session.grasp_error is not None:
                        errors.append(session.grasp_error())
                    if pulse.turns % 10 == 0:
                        line.update(live.live_line(pulse, session.controller.robot))

            turns = session.run(seconds=seconds, observers=(pulse, Shown()), stopped=lambda: stop)
    finally:
        signal.signal(signal.SIGINT, previous)
    console.print(f"{turns} turns at {pulse.rate_hz:.1f} Hz, {pulse.held} held; the arms stand")
    if errors:
        settled = sorted(errors[len(errors) // 5 :])
        middle = 1e3 * settled[len(settled) // 2]
        console.print(f"grippers from x*, median after the approach: {middle:.0f} mm")
    for reason, count in sorted(pulse.reasons.items(), key=lambda item: -item[1])[:5]:
        console.print(f"  held {count} times: {escape(reason)}", highlight=False)


@app.command()
def check(config: ConfigPath, overrides: Set = None) -> None:
    """Check an experiment file and print it with every default written out."""
    from clothrf_core.config import load

    sys.stdout.write(load(config, Registry.installed(), _overrides(overrides)).text)


@app.command()
def plugins(
    kind: Annotated[str | None, typer.Argument(help="only this kind")] = None,
    options: Annotated[bool, typer.Option("--options", help="show the options of each")] = False,
) -> None:
    """List what is installed, and what failed to load with its reason."""
    registry = Registry.installed()
    if kind is not None and kind not in KINDS:
        raise UnknownPlugin(f"no kind of plugin is called '{kind}'. {suggestion(kind, KINDS)}")
    table = Table(box=None, header_style="bold")
    for head in ("kind", "name", "what it is", "from"):
        table.add_column(head)
    for one in [kind] if kind else KINDS:
        for name, entry in sorted(registry.entries[one].items()):
            summary = escape(entry.provider.summary)
            table.add_row(one, f"[bold]{name}[/bold]", summary, entry.distribution)
            if options:
                for key, field in entry.provider.config.model_fields.items():
                    default = "required" if field.is_required() else repr(field.get_default(
                        call_default_factory=True))  # fmt: skip
                    words = escape(field.description or "")
                    table.add_row("", f"  {key}", f"{words} [dim]{escape(default)}[/dim]")
    console.print(table)
    for failure in registry.failures:
        console.print(
            f"[red]failed[/red] {failure.plugin} (from {failure.distribution}): "
            f"{escape(failure.reason)}",
            highlight=False,
            markup=True,
        )


@app.command()
def doctor() -> None:
    """Say what this machine has and lacks, with the command that mends each."""
    from clothrf_core.doctor import examine

    findings = examine(Registry.installed())
    table = Table(box=None, header_style="bold")
    for head in ("", "what", "found", "to mend it"):
        table.add_column(head, overflow="fold")
    signs = {True: "[green]ok[/green]", None: "[yellow]--[/yellow]", False: "[red]!![/red]"}
    for finding in findings:
        words = (finding.what, finding.found, finding.mend)
        table.add_row(signs[finding.ok], *map(escape, words))
    console.print(table)
    if any(f.ok is False for f in findings):
        raise typer.Exit(1)


@app.command()
def info(folder: RunPath) -> None:
    """What a run did: iterations, held-out errors, closed loop."""
    from clothrf_core.report import closed_loop_rows, convergence_rows
    from clothrf_core.run_folder import RunFolder

    run = RunFolder.open(folder)
    records = run.metrics()
    if not records:
        console.print(f"{folder}: no finished iteration yet. Go on with it: clothrf train --resume")
        return
    print_rows(convergence_rows(records))
    closed = run.evaluation().get("closed_loop")
    if closed:
        print_rows(closed_loop_rows(closed))


@app.command()
def bench(
    group: Annotated[str, typer.Argument(help="core, robot, loop, scale, paper, calibration, all")],
    json: Annotated[Path | None, typer.Option(help="write the figures to this file")] = None,
    against: Annotated[Path | None, typer.Option(help="compare with an earlier file")] = None,
    quick: Annotated[bool, typer.Option("--quick", help="minutes, not the real thing")] = False,
    full: Annotated[bool, typer.Option("--full", help="hours: all there is to measure")] = False,
    out: Annotated[
        Path | None, typer.Option(help="folder of a long measurement; a killed one goes on there")
    ] = None,
    only: Annotated[str | None, typer.Option(help="only those with this in their name")] = None,
) -> None:
    """Measure, print, and write figures with the machine they were measured on."""
    from clothrf_core import benchmark
    from clothrf_core.files import atomic_write, json_bytes, read_json
    from clothrf_core.provider import Setting

    registry = Registry.installed()
    groups = sorted({b.group for b in registry.benchmarks})
    if group not in (*groups, "all"):
        raise UnknownPlugin(f"no benchmark group '{group}'. {suggestion(group, [*groups, 'all'])}")
    old = read_json(against) if against else None
    chosen = [
        b
        for b in registry.benchmarks
        if group in (b.group, "all") and (only is None or only in b.name)
    ]
    size: Literal["quick", "usual", "full"] = "full" if full else "quick" if quick else "usual"
    with work_bar() as (plan, done):
        outcomes = benchmark.run_group(
            chosen,
            setting=Setting(size=size, out=out, plan=plan, done=done),
            on_start=lambda b: console.print(f"[dim]{b.group}: {b.name} ...[/dim]"),
        )
    written = benchmark.as_json(outcomes)
    print_figures(written)
    if json:
        atomic_write(json, json_bytes(written))
    if old is not None:
        print_rows(
            [["figure", "before", "now", "now / before"]]
            + [
                [name, short(before), short(now), f"{ratio:.2f}"]
                for name, before, now, ratio in benchmark.changes(written, old)
            ]
        )


@app.command()
def tune(
    config: ConfigPath,
    out: Annotated[Path | None, typer.Option(help="folder; default runs/tune_<config>")] = None,
    overrides: Set = None,
) -> None:
    """Choose the policy's options by cross-validation over roll-outs; a killed search goes on."""
    from clothrf_core.provider import Setting
    from clothrf_core.tuning import table, tune

    target = out or Path("runs") / f"tune_{config.stem}"
    with work_bar() as (plan, done):
        rows = tune(config, Setting(plan=plan, done=done), target, _overrides(overrides))
    print_rows(table(rows)[:16])
    console.print(f"Best config: {target / 'best.toml'}; all of them: {target / 'tune.csv'}")


def main() -> None:
    """Entry point: one line for what the user can mend, a traceback for what we must."""
    _add_plugin_commands(sys.argv[1:])
    try:
        app()
    except ClothrfError as error:
        Console(stderr=True).print(f"clothrf: {error}", markup=False, highlight=False)
        sys.exit(2)
    except KeyboardInterrupt:
        sys.exit(130)


def _add_plugin_commands(arguments: list[str]) -> None:
    """Attach sub-commands of plugins; only the one that is used is imported."""
    chosen = next((a for a in arguments if not a.startswith("-")), "")
    known = {c.name or getattr(c.callback, "__name__", "") for c in app.registered_commands}
    if chosen in known:
        return
    for command in Registry.installed().commands:
        if command.name == chosen:
            app.add_typer(command.load(), name=command.name, help=command.summary)
        else:
            app.command(name=command.name, help=command.summary)(_stub)


def _stub() -> None:
    """Stands for a plugin's command in the list of commands."""


def _overrides(given: list[str] | None) -> dict[str, Any]:
    import tomllib

    values: dict[str, Any] = {}
    for text in given or []:
        key, separator, value = text.partition("=")
        if not separator:
            raise ClothrfError(f"--set {text}: expected key=value, as training.iterations=3")
        try:
            values[key.strip()] = tomllib.loads(f"x = {value}")["x"]
        except tomllib.TOMLDecodeError:
            values[key.strip()] = value.strip()
    return values


def _free(path: Path) -> Path:
    number = 2
    while path.with_name(f"{path.name}-{number}").exists():
        number += 1
    return path.with_name(f"{path.name}-{number}")


if __name__ == "__main__":
    main()
