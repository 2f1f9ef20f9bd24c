"""ABB's dual-arm YuMi (IRB 14000): kinematics, inverse kinematics, limits, motion limiter."""

from __future__ import annotations

from collections.abc import Sequence

from clothrf_core.hookspecs import hookimpl
from clothrf_core.interfaces import ArmModel, BridgeEnd
from clothrf_core.provider import Benchmark, BuildContext, Figure, Provider
from clothrf_yumi.config import SimulatedEndConfig, YumiConfig


@hookimpl
def clothrf_arms() -> Sequence[Provider[ArmModel]]:
    """The YuMi."""
    return [
        Provider(
            "yumi",
            "ABB YuMi IRB 14000: exact nominal kinematics, QP with collision rows, Ruckig",
            _yumi,
            config=YumiConfig,
            extra="yumi",
        )
    ]


@hookimpl
def clothrf_bridge_ends() -> Sequence[Provider[BridgeEnd]]:
    """A YuMi that is only simulated."""
    return [
        Provider(
            "sim",
            "a YuMi that follows with a first-order lag, in this process",
            _simulated_end,
            config=SimulatedEndConfig,
            extra="yumi",
        )
    ]


@hookimpl
def clothrf_benchmarks() -> Sequence[Benchmark]:
    """Inverse kinematics, motion limiter and distances."""
    return [
        Benchmark("robot", "inverse kinematics of both arms", _bench_ik, needs="yumi"),
        Benchmark("robot", "motion limiter", _bench_limiter, needs="yumi"),
        Benchmark("robot", "least distance of all bodies", _bench_checks, needs="yumi"),
    ]


def _bench_ik(quick: bool) -> list[Figure]:  # noqa: FBT001
    from clothrf_yumi.bench import inverse_kinematics

    return inverse_kinematics(quick=quick)


def _bench_limiter(quick: bool) -> list[Figure]:  # noqa: FBT001
    from clothrf_yumi.bench import limiter

    return limiter(quick=quick)


def _bench_checks(quick: bool) -> list[Figure]:  # noqa: FBT001
    from clothrf_yumi.bench import checks

    return checks(quick=quick)


def _yumi(config: YumiConfig, context: BuildContext) -> ArmModel:
    from clothrf_yumi.arm import build

    return build(config, context)


def _simulated_end(config: SimulatedEndConfig, context: BuildContext) -> BridgeEnd:
    import numpy as np

    from clothrf_yumi.simulated_end import SimulatedEnd

    if config.posture is None:
        posture = _yumi(YumiConfig(), context).ready
    else:
        posture = np.array(config.posture)
    return SimulatedEnd(posture, lag=config.lag)
