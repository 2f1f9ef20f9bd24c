"""Resolved config to wired objects: the only file that knows all kinds of component."""

from __future__ import annotations

import functools
from collections.abc import Mapping
from dataclasses import dataclass
from pathlib import Path
from typing import Any, cast

from clothrf_core import config
from clothrf_core.errors import ConfigError, DataError
from clothrf_core.files import atomic_folder, atomic_write, json_bytes, names_digest, read_json
from clothrf_core.interfaces import (
    Camera,
    Expert,
    FeatureExtractor,
    Policy,
    RenderedCamera,
    Robot,
)
from clothrf_core.limits import Limits
from clothrf_core.provider import BuildContext
from clothrf_core.registry import Registry
from clothrf_core.simulated import SimulatedCamera, SimulatedRobot, SimulatedWorld

POLICY_FORMAT = 1


@dataclass(frozen=True)
class Workshop:
    """Everything a simulated roll-out needs."""

    resolved: config.Resolved
    world: SimulatedWorld
    camera: SimulatedCamera
    robot: SimulatedRobot
    extractor: FeatureExtractor
    experts: Mapping[str, Expert]
    limits: Limits


def workshop(resolved: config.Resolved, registry: Registry) -> Workshop:
    """Build the simulated side of an experiment.

    Raises:
        ConfigError: the chosen camera cannot draw.
    """
    context = BuildContext(rig=resolved.rig, folder=resolved.folder, registry=registry)
    dt = 1.0 / resolved.experiment.run.rate_hz
    world = SimulatedWorld(
        simulator=_build(registry, resolved, "simulator", context),
        hands=_build(registry, resolved, "hands", context),
        randomizer=_build(registry, resolved, "randomizer", context),
        rig=resolved.rig,
        cloth=resolved.experiment.cloth,
        dt=dt,
    )
    inside = BuildContext(resolved.rig, world, resolved.folder, registry)
    camera = _build(registry, resolved, "camera", inside)
    if not isinstance(camera, RenderedCamera):
        raise ConfigError(
            f"camera.plugin: training needs a camera that draws the simulation; "
            f"'{resolved.components['camera'].plugin}' does not"
        )
    return Workshop(
        resolved=resolved,
        world=world,
        camera=SimulatedCamera(camera, world),
        robot=SimulatedRobot(world),
        extractor=extractor(resolved, registry),
        experts=experts(resolved, registry),
        limits=Limits(resolved.experiment.limits, dt),
    )


def extractor(resolved: config.Resolved, registry: Registry) -> FeatureExtractor:
    """The feature extractor of an experiment."""
    context = BuildContext(rig=resolved.rig, folder=resolved.folder, registry=registry)
    return cast(FeatureExtractor, _build(registry, resolved, "features", context))


def experts(resolved: config.Resolved, registry: Registry) -> Mapping[str, Expert]:
    """The expert of every task, in the order of the labels."""
    context = BuildContext(rig=resolved.rig, folder=resolved.folder, registry=registry)
    return {
        name: registry.build("expert", chosen.plugin, chosen.options, context)
        for name, chosen in resolved.tasks.items()
    }


def new_policy(resolved: config.Resolved, registry: Registry) -> Policy:
    """An unfitted policy."""
    context = BuildContext(rig=resolved.rig, folder=resolved.folder, registry=registry)
    return cast(Policy, _build(registry, resolved, "policy", context))


def real_camera(resolved: config.Resolved, registry: Registry) -> Camera:
    """The camera of an experiment that has no simulated world."""
    context = BuildContext(rig=resolved.rig, folder=resolved.folder, registry=registry)
    return cast(Camera, _build(registry, resolved, "camera", context))


def robot(resolved: config.Resolved, registry: Registry, world: SimulatedWorld | None) -> Robot:
    """The robot of an experiment."""
    context = BuildContext(resolved.rig, world, resolved.folder, registry)
    return cast(Robot, _build(registry, resolved, "robot", context))


def save_policy(
    folder: Path, policy: Policy, resolved: config.Resolved, names: tuple[str, ...]
) -> None:
    """Write a policy with everything needed to use it: its arrays, its config, its features.

    Equal policies give equal bytes; nothing in the folder depends on time or place.
    """
    with atomic_folder(folder) as temporary:
        policy.save(temporary)
        atomic_write(temporary / "experiment.toml", resolved.text.encode())
        header = {
            "format": POLICY_FORMAT,
            "plugin": resolved.components["policy"].plugin,
            "tasks": list(policy.tasks),
            "features": len(names),
            "names": names_digest(names),
        }
        atomic_write(temporary / "clothrf.json", json_bytes(header))


def open_policy(folder: Path, registry: Registry) -> tuple[Policy, config.Resolved]:
    """A saved policy and the experiment it was trained in.

    Raises:
        DataError: not a policy folder, of another format, or damaged.
    """
    header = read_json(folder / "clothrf.json")
    if not isinstance(header, dict) or header.get("format") != POLICY_FORMAT:
        raise DataError(f"{folder}: expected a policy folder of format {POLICY_FORMAT}")
    resolved = config.load(folder / "experiment.toml", registry)
    if resolved.components["policy"].plugin != header.get("plugin"):
        raise DataError(
            f"{folder}: experiment.toml names policy "
            f"'{resolved.components['policy'].plugin}', clothrf.json '{header.get('plugin')}'"
        )
    return new_policy(resolved, registry).load(folder), resolved


@functools.lru_cache(maxsize=2)
def cached_workshop(path: str) -> Workshop:
    """The workshop of a resolved config file, built once a process; for collection workers."""
    registry = Registry.installed()
    return workshop(config.load(Path(path), registry), registry)


@functools.lru_cache(maxsize=4)
def cached_policy(path: str) -> Policy:
    """A saved policy, read once a process; policy folders never change once written."""
    return open_policy(Path(path), Registry.installed())[0]


def _build(
    registry: Registry, resolved: config.Resolved, section: str, context: BuildContext
) -> Any:
    chosen = resolved.components[section]
    return registry.build(chosen.kind, chosen.plugin, chosen.options, context)
