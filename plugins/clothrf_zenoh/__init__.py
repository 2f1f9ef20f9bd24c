"""The command stream to the robot over Zenoh, and the bridge that decides what reaches the arms."""

from __future__ import annotations

from collections.abc import Callable
from typing import TYPE_CHECKING

from clothrf_core.hookspecs import hookimpl
from clothrf_core.interfaces import Robot
from clothrf_core.provider import Benchmark, BuildContext, Command, Figure, Provider
from clothrf_zenoh.config import YumiZenohConfig

if TYPE_CHECKING:
    import typer


def _robot(config: YumiZenohConfig, context: BuildContext) -> Robot:
    from clothrf_zenoh.robot import StreamedYumi

    return StreamedYumi(config, folder=context.folder, rig=context.rig)


@hookimpl
def clothrf_robots() -> list[Provider[Robot]]:
    """The streamed YuMi."""
    return [
        Provider(
            "yumi_zenoh",
            "two YuMi arms behind a bridge, 250 Hz joint stream over Zenoh",
            _robot,
            YumiZenohConfig,
            "zenoh",
        )
    ]


def _command(name: str) -> Callable[[], typer.Typer]:
    def load() -> typer.Typer:
        from clothrf_zenoh.cli import app_of

        return app_of(name)

    return load


@hookimpl
def clothrf_commands() -> list[Command]:
    """bridge, replay, record, draw, estop."""
    helps = {
        "bridge": "Run the robot-side process: checks, watchdog, arms.",
        "replay": "Play a recording into a running bridge.",
        "record": "Record the stream as an MCAP file.",
        "draw": "Draw the arms of a recording as a film.",
        "estop": "Stop the arms; acknowledged, not safety rated.",
    }
    return [Command(name, text, _command(name)) for name, text in helps.items()]


def _tick(quick: bool) -> list[Figure]:  # noqa: FBT001  the hook's signature
    from clothrf_zenoh.bench import tick

    return tick(quick=quick)


def _hostile(quick: bool) -> list[Figure]:  # noqa: FBT001  the hook's signature
    from clothrf_zenoh.hostile import hostile

    return hostile(quick=quick)


def _stream(quick: bool) -> list[Figure]:  # noqa: FBT001  the hook's signature
    from clothrf_zenoh.bench import stream

    return stream(quick=quick)


def _watchdog(quick: bool) -> list[Figure]:  # noqa: FBT001  the hook's signature
    from clothrf_zenoh.bench import watchdog

    return watchdog(quick=quick)


@hookimpl
def clothrf_benchmarks() -> list[Benchmark]:
    """The bridge's figures."""
    needs = "the extras yumi and zenoh"
    return [
        Benchmark("robot", "bridge tick", _tick, needs),
        Benchmark("robot", "hostile commands", _hostile, needs),
        Benchmark("robot", "joint stream over Zenoh", _stream, needs),
        Benchmark("robot", "command cut", _watchdog, needs),
    ]
