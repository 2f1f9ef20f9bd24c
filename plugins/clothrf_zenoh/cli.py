"""`clothrf bridge`, `replay`, `record`, `draw` and `estop`."""

from __future__ import annotations

import logging
import os
import signal
from collections.abc import Callable, Iterator, Mapping
from contextlib import contextmanager
from pathlib import Path
from types import MappingProxyType
from typing import TYPE_CHECKING, Annotated

import typer

from clothrf_core.clock import WallClock
from clothrf_core.registry import Registry
from clothrf_zenoh.compose import BridgeFile, build_arm, load_bridge
from clothrf_zenoh.config import ZenohSection

if TYPE_CHECKING:
    from clothrf_zenoh.client import BridgeClient

BridgeOption = Annotated[Path, typer.Option(help="the bridge's TOML file")]


def bridge(
    config: Annotated[Path, typer.Argument(help="the bridge's TOML file")],
    check: Annotated[bool, typer.Option("--check", help="check the file and open nothing")] = False,
) -> None:
    """Run the robot-side process: checks, watchdog, arms."""
    from clothrf_zenoh.compose import bounds_of, build_end
    from clothrf_zenoh.serve import serve
    from clothrf_zenoh.session import options_of, require_protection

    registry = Registry.installed()
    file = load_bridge(config, registry)
    require_protection(file.config.zenoh)
    options_of(file.config.zenoh, file.folder)
    if check:
        build_end(file, registry)
        bounds = bounds_of(build_arm(file, registry), file.config.limits, 1.0 / file.config.rate_hz)
        print(f"{config}: good; {_summary(file)}, {len(bounds.names)} joints")
        return
    _show_log()
    status = serve(file, registry, WallClock(), _until_interrupted(), ready=_say)
    print(f"bridge: stopped after {status['ticks']} ticks, {status['overruns']} overruns")


def replay(
    recording: Annotated[Path, typer.Argument(help="MCAP file with joint commands")],
    bridge: BridgeOption,
) -> None:
    """Play a recording into a running bridge."""
    from clothrf_zenoh.replay import read_commands
    from clothrf_zenoh.replay import replay as play

    registry = Registry.installed()
    file = load_bridge(bridge, registry)
    names = tuple(build_arm(file, registry).joint_names)
    commands = read_commands(recording, names)
    with _client_of(file, names) as client:
        client.wait_for_bridge(5.0)
        sent = play(commands, client, WallClock(), stop=_until_interrupted())
    print(f"replay: {sent} of {len(commands.times_ns)} commands sent")


def record(
    recording: Annotated[Path, typer.Argument(help="MCAP file to write")],
    bridge: BridgeOption,
) -> None:
    """Record commands, targets, joint states and health until Ctrl-C."""
    from clothrf_zenoh.record import record as write

    file = load_bridge(bridge, Registry.installed())
    count = write(as_client(file), file.folder, recording, WallClock(), _until_interrupted())
    print(f"record: {count} messages in {recording}")


def estop(
    bridge: BridgeOption,
    clear: Annotated[bool, typer.Option("--clear", help="leave the stop again")] = False,
) -> None:
    """Software stop, acknowledged by the bridge. Not safety rated: use the pendant's."""
    file = load_bridge(bridge, Registry.installed())
    with _client_of(file, ()) as client:
        client.wait_for_link(5.0)
        reply = client.ask("clear") if clear else client.emergency_stop("the command line")
    print(f"bridge: {reply.state}")


def draw(
    recording: Annotated[Path, typer.Argument(help="MCAP file of clothrf record")],
    bridge: BridgeOption,
    out: Annotated[Path | None, typer.Option(help="GIF; default beside the recording")] = None,
    camera: Annotated[str, typer.Option(help="camera that draws: raster or sapien")] = "raster",
) -> None:
    """Draw the measured arms of a recording as a film."""
    from clothrf_core.console import progress_bar
    from clothrf_core.files import atomic_write
    from clothrf_zenoh.draw import film

    registry = Registry.installed()
    file = load_bridge(bridge, registry)
    arm = build_arm(file, registry)
    target = out or recording.with_suffix(".gif")
    with progress_bar() as bar:
        row = bar.add_task("frames", total=None)

        def drawn(total: int) -> None:
            bar.update(row, total=total, advance=1)

        data = film(recording, arm, registry, camera=camera, on_frame=drawn)
    atomic_write(target, data)
    print(f"draw: {target}")


# Name -> (what it runs, an example of its arguments).
COMMANDS: Mapping[str, tuple[Callable[..., None], str]] = MappingProxyType(
    {
        "bridge": (bridge, "configs/bridge_sim.toml"),
        "replay": (replay, "run.mcap --bridge configs/bridge_sim.toml"),
        "record": (record, "run.mcap --bridge configs/bridge_sim.toml"),
        "draw": (draw, "run.mcap --bridge configs/bridge_sim.toml --camera sapien"),
        "estop": (estop, "--bridge configs/bridge_sim.toml"),
    }
)


def app_of(name: str) -> typer.Typer:
    """`clothrf NAME`, one of `COMMANDS`."""
    function, example = COMMANDS[name]
    app = typer.Typer(context_settings={"allow_interspersed_args": True})
    app.callback(invoke_without_command=True, epilog=f"Example: clothrf {name} {example}")(function)
    return app


@contextmanager
def _client_of(file: BridgeFile, names: tuple[str, ...]) -> Iterator[BridgeClient]:
    """A client of the bridge of `file`, in contact with its address."""
    from clothrf_zenoh.client import BridgeClient
    from clothrf_zenoh.session import keys_of, open_session

    section = as_client(file)
    with (
        open_session(section, file.folder) as session,
        BridgeClient(session, keys_of(section), os.urandom(16), names) as client,
    ):
        yield client


def as_client(file: BridgeFile) -> ZenohSection:
    """The section with which a program on the same machine reaches the bridge of `file`."""
    section = file.config.zenoh
    return section.model_copy(
        update={"connect": [*section.listen, *section.connect], "listen": [], "access": []}
    )


def _summary(file: BridgeFile) -> str:
    zenoh = file.config.zenoh
    locks = [name for name in ("tls", "user", "access") if getattr(zenoh, name)]
    where = ", ".join([*zenoh.listen, *zenoh.connect])
    safe = " + ".join(locks) or ("insecure" if zenoh.insecure else "this machine only")
    return f"arm {file.arm[0]}, end {file.end[0]}, {where} ({safe})"


def _say(text: str) -> None:
    print(text, flush=True)


def _show_log() -> None:
    """Changes of the bridge's state go to the terminal."""
    handler = logging.StreamHandler()
    handler.setFormatter(logging.Formatter("%(message)s"))
    log = logging.getLogger("clothrf_zenoh")
    log.addHandler(handler)
    log.setLevel(logging.INFO)


def _until_interrupted() -> Callable[[], bool]:
    """True after Ctrl-C or SIGTERM; the loop then ends in order, arms at rest."""
    seen: list[int] = []
    for number in (signal.SIGINT, signal.SIGTERM):
        signal.signal(number, lambda n, _frame: seen.append(n))
    return lambda: bool(seen)
