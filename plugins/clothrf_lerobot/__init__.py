"""Data for others: roll-outs as a LeRobotDataset v3.0 or an MCAP file, and back again."""

from __future__ import annotations

from typing import TYPE_CHECKING

from clothrf_core.hookspecs import hookimpl
from clothrf_core.provider import Command

if TYPE_CHECKING:
    import typer


def _export() -> typer.Typer:
    from clothrf_lerobot.cli import export_app

    return export_app()


def _import() -> typer.Typer:
    from clothrf_lerobot.cli import import_app

    return import_app()


@hookimpl
def clothrf_commands() -> list[Command]:
    """export, import."""
    return [
        Command("export", "Write roll-outs as a LeRobotDataset v3.0 or an MCAP file.", _export),
        Command("import", "Read a LeRobotDataset v3.0 into a data set to train on.", _import),
    ]
