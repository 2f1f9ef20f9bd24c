"""Bridge file -> checked options -> arm model and end; no other file here asks the registry."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass
from pathlib import Path
from typing import Any

from pydantic import ValidationError

from clothrf_core.config import read_rig, read_toml
from clothrf_core.errors import ClothrfError, ConfigError, suggestion
from clothrf_core.interfaces import ArmModel, BridgeEnd
from clothrf_core.provider import BuildContext
from clothrf_core.registry import Registry
from clothrf_core.rig import Rig, Section
from clothrf_zenoh.checks import Bounds
from clothrf_zenoh.config import BridgeConfig, LimitsSection


@dataclass(frozen=True)
class BridgeFile:
    """A checked bridge file.

    Attributes:
        config: all sections.
        arm: plugin name and checked options of the arm model.
        end: plugin name and checked options of the end.
        folder: where relative paths start.
        rig: of the arms' surroundings; None = the arm model's own.
    """

    config: BridgeConfig
    arm: tuple[str, Section]
    end: tuple[str, Section]
    folder: Path
    rig: Rig | None = None


def load_bridge(path: Path, registry: Registry) -> BridgeFile:
    """Read and check a bridge file.

    Raises:
        ConfigError: listing every problem with section, key, value and nearest name.
    """
    return resolve_bridge(read_toml(path), registry, folder=path.parent, source=str(path))


def resolve_bridge(
    data: Mapping[str, Any], registry: Registry, *, folder: Path, source: str = "bridge"
) -> BridgeFile:
    """Check what a bridge file said; see `load_bridge`."""
    problems: list[str] = []
    config: BridgeConfig | None = None
    try:
        config = BridgeConfig.model_validate(data)
    except ValidationError as error:
        problems += describe(error, BridgeConfig)
    chosen = []
    for kind, section in (("arm", "arm"), ("bridge_end", "end")):
        options = data.get(section)
        if isinstance(options, Mapping):
            try:
                chosen.append(choose(kind, section, options, registry))
            except ClothrfError as error:
                problems.append(str(error))
    rig = None
    if config is not None and config.rig is not None:
        try:
            rig = read_rig(folder / config.rig)
        except ClothrfError as error:
            problems.append(f"rig: {error}")
    if problems or config is None or len(chosen) != 2:
        count = f"{len(problems)} problem{'s' if len(problems) != 1 else ''}"
        raise ConfigError(f"{source}: {count}\n" + "\n".join(f"  {p}" for p in problems))
    return BridgeFile(config, chosen[0], chosen[1], folder, rig)


def choose(
    kind: str, section: str, data: Mapping[str, Any], registry: Registry
) -> tuple[str, Section]:
    """The plugin that a section names and its checked options.

    Raises:
        ConfigError: no such plugin or wrong options; names section and key.
    """
    options = dict(data)
    name = options.pop("plugin", None)
    if not isinstance(name, str):
        names = ", ".join(registry.names(kind)) or "none"
        raise ConfigError(f'{section}.plugin: missing; write plugin = "...". Installed: {names}')
    try:
        provider = registry.find(kind, name)
    except ClothrfError as error:
        raise ConfigError(f"{section}.plugin: {error}") from error
    try:
        return name, provider.config.model_validate(options)
    except ValidationError as error:
        lines = describe(error, provider.config, f"{section}.")
        raise ConfigError("; ".join(lines)) from error


def describe(error: ValidationError, model: type[Section], prefix: str = "") -> list[str]:
    """One line a problem: section, key, value, nearest known key."""
    lines = []
    for item in error.errors(include_url=False):
        where = prefix + ".".join(str(part) for part in item["loc"])
        if item["type"] == "extra_forbidden":
            owner = model
            for part in item["loc"][:-1]:
                inner = owner.model_fields.get(str(part))
                kind = inner.annotation if inner is not None else None
                if isinstance(kind, type) and issubclass(kind, Section):
                    owner = kind
            hint = suggestion(str(item["loc"][-1]), owner.model_fields)
            lines.append(f"{where}: unknown key. {hint}")
        else:
            lines.append(f"{where}: {item['msg']} (got {item['input']!r})")
    return lines


def build_arm(file: BridgeFile, registry: Registry) -> ArmModel:
    """The kinematic model."""
    context = BuildContext(rig=file.rig, folder=file.folder, registry=registry)
    arm: ArmModel = registry.build("arm", file.arm[0], file.arm[1], context)
    return arm


def build_end(file: BridgeFile, registry: Registry) -> BridgeEnd:
    """Where the stream ends; nothing is opened yet."""
    context = BuildContext(rig=file.rig, folder=file.folder, registry=registry)
    end: BridgeEnd = registry.build("bridge_end", file.end[0], file.end[1], context)
    return end


def bounds_of(arm: ArmModel, limits: LimitsSection, dt: float) -> Bounds:
    """All numbers that the checks compare against.

    Raises:
        ConfigError: limits that contradict each other.
    """
    box = (_point(limits.box_low), _point(limits.box_high))
    if not all(low < high for low, high in zip(*box, strict=True)):
        raise ConfigError(f"limits.box_low: expected below box_high, found {limits.box_low}")
    if limits.tcp_speed > limits.tcp_speed_hard:
        raise ConfigError(
            f"limits.tcp_speed: expected at most tcp_speed_hard {limits.tcp_speed_hard}, "
            f"found {limits.tcp_speed}"
        )
    if limits.watchdog_s < 3.0 * dt:
        raise ConfigError(
            f"limits.watchdog_s: expected at least three ticks, {3e3 * dt:g} ms, found "
            f"{1e3 * limits.watchdog_s:g} ms"
        )
    joint = arm.limits
    return Bounds(
        names=tuple(arm.joint_names),
        lower=joint.soft_lower,
        upper=joint.soft_upper,
        velocity=joint.velocity,
        acceleration=joint.acceleration,
        cruise=joint.cruise,
        jerk=joint.jerk,
        dt=dt,
        tcp_speed=limits.tcp_speed,
        tcp_speed_hard=limits.tcp_speed_hard,
        box=box,
        clearance=limits.clearance,
        clearance_ahead=max(limits.clearance, limits.clearance_ahead),
        max_age_ns=int(1e9 * limits.max_age_s),
        max_future_ns=int(1e9 * limits.max_future_s),
        start_joint=limits.start_joint,
        start_tcp=limits.start_tcp,
        following=limits.following,
    )


def _point(values: list[float]) -> tuple[float, float, float]:
    x, y, z = values
    return (float(x), float(y), float(z))
