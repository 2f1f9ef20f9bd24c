"""A second simulator, on MuJoCo's flex: the first one's referee, and another world to test in."""

from __future__ import annotations

from collections.abc import Sequence

from clothrf_core.hookspecs import hookimpl
from clothrf_core.interfaces import Simulator
from clothrf_core.provider import BuildContext, Provider
from clothrf_mujoco.config import FlexOptions


def _simulator(config: FlexOptions, context: BuildContext) -> Simulator:
    from clothrf_mujoco.simulator import FlexSimulator

    return FlexSimulator(config)


@hookimpl
def clothrf_simulators() -> Sequence[Provider[Simulator]]:
    """MuJoCo's finite elements; needs neither a GPU nor a graphics driver."""
    return [
        Provider(
            name="mujoco",
            summary="cloth of finite elements by MuJoCo's flex, with self-collision",
            build=_simulator,
            config=FlexOptions,
            extra="mujoco",
        )
    ]
