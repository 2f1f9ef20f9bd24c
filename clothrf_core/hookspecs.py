"""The extension points: one typed hook per kind of component.

A plugin is a module named by an entry point of the group ``clothrf``. It holds functions with
these names, decorated with `hookimpl`, that return `Provider`s, and imports nothing heavy: heavy
imports stand inside the provider's `build`.
"""

from __future__ import annotations

from collections.abc import Sequence

import pluggy

from clothrf_core.interfaces import (
    ArmModel,
    BridgeEnd,
    Camera,
    Expert,
    FeatureExtractor,
    HandMotion,
    Policy,
    Randomizer,
    Robot,
    Simulator,
)
from clothrf_core.provider import Benchmark, Command, Provider

hookspec = pluggy.HookspecMarker("clothrf")
hookimpl = pluggy.HookimplMarker("clothrf")


@hookspec
def clothrf_simulators() -> Sequence[Provider[Simulator]]:
    """Cloth simulators."""
    raise NotImplementedError


@hookspec
def clothrf_cameras() -> Sequence[Provider[Camera]]:
    """Cameras, rendered or real."""
    raise NotImplementedError


@hookspec
def clothrf_features() -> Sequence[Provider[FeatureExtractor]]:
    """Feature extractors."""
    raise NotImplementedError


@hookspec
def clothrf_policies() -> Sequence[Provider[Policy]]:
    """Policies that can be fitted, saved and loaded."""
    raise NotImplementedError


@hookspec
def clothrf_experts() -> Sequence[Provider[Expert]]:
    """Experts, one a task."""
    raise NotImplementedError


@hookspec
def clothrf_hands() -> Sequence[Provider[HandMotion]]:
    """Motions of the person's hands."""
    raise NotImplementedError


@hookspec
def clothrf_robots() -> Sequence[Provider[Robot]]:
    """Robots, simulated or streamed to."""
    raise NotImplementedError


@hookspec
def clothrf_randomizers() -> Sequence[Provider[Randomizer]]:
    """Randomisers of roll-outs and pictures."""
    raise NotImplementedError


@hookspec
def clothrf_arms() -> Sequence[Provider[ArmModel]]:
    """Kinematic models that the robot stream and the bridge use."""
    raise NotImplementedError


@hookspec
def clothrf_bridge_ends() -> Sequence[Provider[BridgeEnd]]:
    """Ends of the bridge: what follows the joint stream."""
    raise NotImplementedError


@hookspec
def clothrf_commands() -> Sequence[Command]:
    """Sub-commands of the command line."""
    raise NotImplementedError


@hookspec
def clothrf_benchmarks() -> Sequence[Benchmark]:
    """Measurements that `clothrf bench GROUP` runs."""
    raise NotImplementedError
