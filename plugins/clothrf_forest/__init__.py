"""Policy: random forest controller, single-task and multi-task."""

from __future__ import annotations

from clothrf_core.hookspecs import hookimpl
from clothrf_core.interfaces import Policy
from clothrf_core.provider import BuildContext, Provider
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
            summary="random forest on mean-shift labels; leaves hold actions of every task",
            build=_build,
            config=ForestConfig,
            extra="forest",
        )
    ]
