"""The SAPIEN backend: cloth held by four corners, and pictures of it."""

from __future__ import annotations

from collections.abc import Sequence

from clothrf_core.hookspecs import hookimpl
from clothrf_core.interfaces import Simulator
from clothrf_core.provider import BuildContext, Provider
from clothrf_sapien.config import ClothOptions


def _simulator(config: ClothOptions, context: BuildContext) -> Simulator:
    from clothrf_sapien.simulator import ClothSimulator

    return ClothSimulator(config)


@hookimpl
def clothrf_simulators() -> Sequence[Provider[Simulator]]:
    """The implicit cloth; needs neither a GPU nor a graphics driver."""
    return [
        Provider(
            name="sapien",
            summary="implicit cloth held by four corners (Newton, banded Cholesky)",
            build=_simulator,
            config=ClothOptions,
            extra="fast",
        )
    ]
