"""ABB's Externally Guided Motion: the real end of the bridge, and a simulated controller."""

from __future__ import annotations

from collections.abc import Sequence
from typing import TYPE_CHECKING

from clothrf_core.hookspecs import hookimpl
from clothrf_core.interfaces import BridgeEnd
from clothrf_core.provider import Benchmark, BuildContext, Command, Figure, Provider
from clothrf_egm.config import EgmConfig

if TYPE_CHECKING:
    import typer


@hookimpl
def clothrf_bridge_ends() -> Sequence[Provider[BridgeEnd]]:
    """Both arms over UDP."""
    return [
        Provider(
            "egm",
            "ABB Externally Guided Motion: two UDP sessions in position mode",
            _egm,
            config=EgmConfig,
        )
    ]


@hookimpl
def clothrf_commands() -> Sequence[Command]:
    """The simulated controller."""
    return [Command("egm-sim", "Simulate the YuMi's controller: two EGM sessions on UDP", _cli)]


@hookimpl
def clothrf_benchmarks() -> Sequence[Benchmark]:
    """How many requests are answered in their own cycle."""
    return [Benchmark("robot", "EGM answers to two simulated controllers", _bench)]


def _egm(config: EgmConfig, context: BuildContext) -> BridgeEnd:
    from clothrf_egm.end import EgmEnd

    return EgmEnd(config)


def _cli() -> typer.Typer:
    from clothrf_egm.cli import egm_sim_app

    return egm_sim_app()


def _bench(quick: bool) -> list[Figure]:  # noqa: FBT001
    from clothrf_egm.bench import same_cycle

    return same_cycle(quick=quick)
