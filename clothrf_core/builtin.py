"""The core's own components; they enter by the same door as everybody's."""

from __future__ import annotations

from collections.abc import Sequence
from typing import Any

from clothrf_core.errors import ConfigError
from clothrf_core.hookspecs import hookimpl
from clothrf_core.interfaces import Robot
from clothrf_core.provider import (
    Benchmark,
    BuildContext,
    Figure,
    NoOptions,
    Provider,
    Setting,
)


@hookimpl
def clothrf_robots() -> Sequence[Provider[Robot]]:
    """The simulated robot."""
    return [
        Provider(
            name="simulated",
            summary="grippers of the simulated world; sending lets one control period pass",
            build=_simulated,
        )
    ]


def _simulated(_: NoOptions, context: BuildContext) -> Robot:
    from clothrf_core.simulated import SimulatedRobot

    if context.world is None:
        raise ConfigError("robot 'simulated' needs a simulated world; it has none here")
    return SimulatedRobot(context.world)


@hookimpl
def clothrf_benchmarks() -> Sequence[Benchmark]:
    """Measurements of the spine."""
    return [
        Benchmark("core", "collection of samples", lambda quick: _bench().collection(quick)),
        Benchmark("core", "the paper's schedule", lambda quick: _bench().schedule(quick)),
        Benchmark("core", "kill and resume", lambda quick: _bench().resumption(quick)),
        Benchmark(
            "paper", "the paper's claims", _quick_paper, study=lambda how: _paper().paper(how)
        ),
        Benchmark("loop", "frame to command", lambda quick: _loop().frame_to_command(quick)),
        Benchmark("scale", "two Dask workers", lambda quick: _scale().two_workers(quick)),
        Benchmark("scale", "a Dask worker killed", lambda quick: _scale().killed_worker(quick)),
        Benchmark("scale", "100,000 samples", lambda quick: _scale().hundred_thousand(quick)),
    ]


def _bench() -> Any:
    from clothrf_core import bench

    return bench


def _paper() -> Any:
    from clothrf_core.paper import run

    return run


def _quick_paper(quick: bool) -> list[Figure]:  # noqa: FBT001  the signature that Benchmark asks for
    figures: list[Figure] = _paper().paper(Setting(size="quick" if quick else "usual"))
    return figures


def _loop() -> Any:
    from clothrf_core import bench_loop

    return bench_loop


def _scale() -> Any:
    from clothrf_core import bench_scale

    return bench_scale
