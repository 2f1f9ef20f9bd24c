"""`clothrf export` and `clothrf import`."""

from __future__ import annotations

import enum
import importlib
from pathlib import Path
from typing import Annotated, Any

import typer

from clothrf_core.console import progress_bar
from clothrf_core.errors import MissingDependency
from clothrf_core.registry import Registry

INTERSPERSED = {"allow_interspersed_args": True}


class Format(enum.StrEnum):
    """What can be written."""

    LEROBOT = "lerobot"
    MCAP = "mcap"


def export_app() -> typer.Typer:
    """`clothrf export RUN_OR_DATASET OUT [--format lerobot|mcap] [--pictures]`."""
    app = typer.Typer(context_settings=INTERSPERSED)

    @app.callback(
        invoke_without_command=True, epilog="Example: clothrf export runs/demo cloth --pictures"
    )
    def export(
        source: Annotated[Path, typer.Argument(help="run folder, or a data set folder")],
        out: Annotated[Path, typer.Argument(help="folder to write; a file for mcap")],
        format: Annotated[Format, typer.Option(help="what to write")] = Format.LEROBOT,
        pictures: Annotated[
            bool, typer.Option("--pictures", help="draw colour and depth again from the seeds")
        ] = False,
        fps: Annotated[
            float | None,
            typer.Option(help="samples a second, of a data set without its run", min=0.1),
        ] = None,
    ) -> None:
        """Write roll-outs as a LeRobotDataset v3.0 (a killed export goes on) or an MCAP file."""
        from clothrf_lerobot.source import open_source

        needed = ["pyarrow"] if format is Format.LEROBOT else ["mcap", "mcap_ros2"]
        module = "writer" if format is Format.LEROBOT else "rosbag"
        write = _needing([*needed, *(["av"] if pictures else [])], module).export
        registry = Registry.installed()
        found = open_source(source, registry, fps)
        with progress_bar() as bar:
            row = bar.add_task("episodes", total=len(found.paths))
            new = write(
                found, registry, out, pictures=pictures, on_episode=lambda: bar.advance(row)
            )
        there = len(found.paths) - new
        print(f"{out}: {new} episodes written" + (f", {there} were there" if there else ""))

    return app


def import_app() -> typer.Typer:
    """`clothrf import LEROBOT OUT [--map ROLE=COLUMN]`."""
    app = typer.Typer(context_settings=INTERSPERSED)

    @app.callback(
        invoke_without_command=True,
        epilog="Example: clothrf import cloth data; clothrf train configs/straight.toml "
        "--data data",
    )
    def import_(
        folder: Annotated[Path, typer.Argument(help="LeRobotDataset v3.0")],
        out: Annotated[Path, typer.Argument(help="data set folder to make")],
        columns: Annotated[
            list[str] | None,
            typer.Option(
                "--map",
                help="a stranger's columns: features=, labels=, grasps=, anchors=; as "
                "labels=action[0:6]; repeatable",
            ),
        ] = None,
        task: Annotated[
            str | None, typer.Option(help="only a stranger's episodes of this task")
        ] = None,
        held_out: Annotated[
            float, typer.Option(help="share of a stranger's episodes to test on", min=0, max=0.5)
        ] = 0.1,
    ) -> None:
        """Read a LeRobotDataset v3.0 into a data set to train on: clothrf train --data."""
        read = _needing(["pyarrow"], "reader").import_dataset
        made = read(folder, out, columns=tuple(columns or ()), task=task, held_out=held_out)
        print(
            f"{out}: {made.rollouts} roll-outs, {made.held_out} of them held out, "
            f"{made.rows} rows, {', '.join(made.tasks)}"
        )

    return app


def _needing(packages: list[str], module: str) -> Any:
    """A module of this plugin, once what it imports is known to be there."""
    for name in packages:
        try:
            importlib.import_module(name)
        except ImportError as error:
            extra = "record" if name.startswith("mcap") else "lerobot"
            raise MissingDependency(
                f"this needs '{name}', which is not installed. "
                f"Install it with: pip install 'clothrf[{extra}]'"
            ) from error
    return importlib.import_module(f"clothrf_lerobot.{module}")
