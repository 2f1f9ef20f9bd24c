"""Policy: random forest controller, single-task and multi-task."""

from __future__ import annotations

from clothrf_core.hookspecs import hookimpl
from clothrf_core.interfaces import Policy
from clothrf_core.provider import Benchmark, BuildContext, Figure, Provider
from clothrf_forest.config import ForestConfig


def _build(config: ForestConfig, context: BuildContext) -> Policy:
    from clothrf_forest.policy import Forest

    return Forest(config)


@hookimpl
def clothrf_policies() -> list[Provider[Policy]]:
    """The forest."""
    return [
        Provider(
            name="forest",
            summary="random forest on a linear base; one for all tasks; the paper's by config",
            build=_build,
            config=ForestConfig,
            extra="forest",
        )
    ]


def _row(quick: bool) -> list[Figure]:  # noqa: FBT001  the hook's signature
    from clothrf_forest import bench

    return bench.row(quick)


def _train(quick: bool) -> list[Figure]:  # noqa: FBT001  the hook's signature
    from clothrf_forest import bench

    return bench.train(quick)


def _million(quick: bool) -> list[Figure]:  # noqa: FBT001  the hook's signature
    from clothrf_forest import bench

    return bench.million(quick)


@hookimpl
def clothrf_benchmarks() -> list[Benchmark]:
    """One row, a fit against scikit-learn, a million rows."""
    return [
        Benchmark("core", "forest row", _row),
        Benchmark("scale", "forest training against scikit-learn", _train),
        Benchmark("scale", "forest of a million rows", _million),
    ]
