"""Randomisers of roll-outs and pictures: hands, cloth, camera, light, occluders, depth sensors."""

from __future__ import annotations

from collections.abc import Sequence

from clothrf_core.hookspecs import hookimpl
from clothrf_core.interfaces import Randomizer
from clothrf_core.provider import Benchmark, BuildContext, Figure, NoOptions, Provider
from clothrf_randomize.config import StandardConfig


@hookimpl
def clothrf_randomizers() -> Sequence[Provider[Randomizer]]:
    """Nothing at all, or everything with a strength each."""
    return [
        Provider("none", "every roll-out is the nominal one, the sensor is perfect", _none),
        Provider(
            "standard",
            "hands, fabric, size, mesh, camera, light, occluders and sensor noise",
            _standard,
            config=StandardConfig,
            extra="fast",
        ),
    ]


@hookimpl
def clothrf_benchmarks() -> Sequence[Benchmark]:
    """Time of one disturbed frame."""
    return [Benchmark("core", "sensor noise of a frame", _bench)]


def _none(config: NoOptions, context: BuildContext) -> Randomizer:
    from clothrf_randomize.identity import Identity

    return Identity()


def _standard(config: StandardConfig, context: BuildContext) -> Randomizer:
    from clothrf_randomize.standard import Standard

    return Standard(config)


def _bench(quick: bool) -> list[Figure]:  # noqa: FBT001  the signature that Benchmark asks for
    from clothrf_randomize.bench import corrupt_figures

    return corrupt_figures(quick=quick)
