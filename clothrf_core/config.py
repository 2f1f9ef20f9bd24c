"""One TOML file an experiment, checked in two passes, all problems reported at once.

First the sections are read (`Experiment`); then each section that names a plugin is checked by
that plugin's own pydantic model. There is no list of plugins here, no inheritance, no
interpolation: a file can be read alone.
"""

from __future__ import annotations

import re
import tomllib
from collections.abc import Mapping
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any

import tomli_w
from pydantic import BaseModel, ValidationError

from clothrf_core.camera_file import read_camera_file
from clothrf_core.errors import ClothrfError, ConfigError, suggestion
from clothrf_core.registry import Registry
from clothrf_core.rig import Rig, Section
from clothrf_core.sections import Experiment

KIND_OF_SECTION = ("simulator", "camera", "features", "policy", "hands", "randomizer", "robot")


@dataclass(frozen=True)
class Component:
    """A plugin chosen by the config and its checked options."""

    kind: str
    plugin: str
    options: Section


@dataclass(frozen=True)
class Resolved:
    """A config in which nothing is left open.

    Attributes:
        experiment: the plain sections.
        rig: the rig, read from its file.
        components: section -> chosen plugin.
        tasks: task name -> chosen expert, in order.
        folder: where relative paths start.
    """

    experiment: Experiment
    rig: Rig
    components: Mapping[str, Component]
    tasks: Mapping[str, Component]
    folder: Path
    source: str = ""
    text: str = field(default="", repr=False)

    @property
    def task_names(self) -> tuple[str, ...]:
        """In the order of the labels."""
        return tuple(self.tasks)


def load(path: Path, registry: Registry, overrides: Mapping[str, Any] | None = None) -> Resolved:
    """Read, check and resolve an experiment file.

    Args:
        path: the TOML file.
        registry: what is installed.
        overrides: dotted keys to replace, as ``{"training.iterations": 3}``.

    Raises:
        ConfigError: listing every problem with file, section, key, value and nearest name.
    """
    data = read_toml(path)
    for dotted, value in (overrides or {}).items():
        _put(data, dotted.split("."), value)
    return resolve(data, registry, folder=path.parent, source=str(path))


def resolve(
    data: Mapping[str, Any], registry: Registry, *, folder: Path, source: str = "config"
) -> Resolved:
    """Check and resolve what a TOML file said; see `load`."""
    problems: list[str] = []
    try:
        experiment = Experiment.model_validate(data)
    except ValidationError as error:
        problems += _messages(error, Experiment, "")
        known = {k: v for k, v in data.items() if k in Experiment.model_fields}
        experiment = _salvaged(known)
    rig = _rig(experiment.rig, folder, problems)
    components: dict[str, Component] = {}
    for section in KIND_OF_SECTION:
        usual = Experiment.model_fields[section].get_default()
        options = {**usual, **getattr(experiment, section)}
        chosen = _component(section, section, options, registry, problems)
        if chosen is not None:
            components[section] = chosen
    tasks: dict[str, Component] = {}
    if not experiment.tasks:
        problems.append("tasks: expected at least one task, as in [tasks.straight]")
    for name, options in experiment.tasks.items():
        chosen = _component("expert", f"tasks.{name}", options, registry, problems)
        if chosen is not None:
            tasks[name] = chosen
    if problems or rig is None:
        count = f"{len(problems)} problem{'s' if len(problems) != 1 else ''}"
        raise ConfigError(f"{source}: {count}\n" + "\n".join(f"  {p}" for p in problems))
    resolved = Resolved(experiment, rig, components, tasks, folder, source)
    return Resolved(experiment, rig, components, tasks, folder, source, to_toml(resolved))


def to_toml(resolved: Resolved) -> str:
    """The whole config with every default written out; reading it again gives the same."""
    tree: dict[str, Any] = resolved.experiment.model_dump(mode="json")
    tree["rig"] = resolved.rig.model_dump(mode="json")
    for section, chosen in resolved.components.items():
        tree[section] = {"plugin": chosen.plugin, **chosen.options.model_dump(mode="json")}
    tree["tasks"] = {
        name: {"plugin": chosen.plugin, **chosen.options.model_dump(mode="json")}
        for name, chosen in resolved.tasks.items()
    }
    text = tomli_w.dumps(_without_none(tree))
    return re.sub(r"\[\s+([^\[\]]*?),?\s+\]", _one_line, text)


def read_toml(path: Path) -> dict[str, Any]:
    """The tables of a TOML file.

    Raises:
        ConfigError: missing or not TOML; says where.
    """
    try:
        with path.open("rb") as file:
            return tomllib.load(file)
    except FileNotFoundError as error:
        raise ConfigError(f"{path}: no such file") from error
    except (tomllib.TOMLDecodeError, UnicodeDecodeError) as error:
        raise ConfigError(f"{path}: expected TOML, {error}") from error
    except OSError as error:
        raise ConfigError(f"{path}: cannot be read ({error.strerror})") from error


def read_rig(path: Path) -> Rig:
    """A rig file on its own.

    Raises:
        ConfigError: listing every problem.
    """
    problems: list[str] = []
    rig = _rig({"file": path.name}, path.parent, problems)
    if rig is None:
        raise ConfigError("\n".join(problems))
    return rig


def _rig(data: Mapping[str, Any], folder: Path, problems: list[str]) -> Rig | None:
    prefix = "rig"
    tree: dict[str, Any] = dict(data)
    try:
        if "file" in tree:
            path = folder / str(tree.pop("file"))
            prefix = f"rig ({path})"
            tree = {**read_toml(path), **tree}
            folder = path.parent
        camera = tree.get("camera")
        if isinstance(camera, dict) and "file" in camera:
            path = folder / str(camera["file"])
            rest = {k: v for k, v in camera.items() if k != "file"}
            tree["camera"] = {**read_camera_file(path).model_dump(), **rest}
        rig = Rig.model_validate(tree)
        rig.camera.model()
        return rig
    except ValidationError as error:
        problems += _messages(error, Rig, f"{prefix}.")
    except ClothrfError as error:
        problems.append(f"{prefix}: {error}")
    return None


def _component(
    kind: str, where: str, data: Mapping[str, Any], registry: Registry, problems: list[str]
) -> Component | None:
    options = dict(data)
    name = options.pop("plugin", None)
    if not isinstance(name, str):
        installed = ", ".join(registry.names(kind)) or "none"
        problems.append(f'{where}.plugin: missing; write plugin = "...". Installed: {installed}')
        return None
    try:
        provider = registry.find(kind, name)
        return Component(kind, name, provider.config.model_validate(options))
    except ValidationError as error:
        problems += _messages(error, provider.config, f"{where}.")
    except ClothrfError as error:
        problems.append(f"{where}.plugin: {error}")
    return None


def _messages(error: ValidationError, model: type[BaseModel], prefix: str) -> list[str]:
    lines = []
    for item in error.errors(include_url=False):
        where = prefix + ".".join(str(part) for part in item["loc"])
        if item["type"] == "extra_forbidden":
            known = _fields_at(model, item["loc"][:-1])
            lines.append(f"{where}: unknown key. {suggestion(str(item['loc'][-1]), known)}")
        else:
            lines.append(f"{where}: {item['msg']} (got {item['input']!r})")
    return lines


def _fields_at(model: type[BaseModel], path: tuple[int | str, ...]) -> list[str]:
    for part in path:
        found = model.model_fields.get(str(part))
        inner = found.annotation if found is not None else None
        if not (isinstance(inner, type) and issubclass(inner, BaseModel)):
            break
        model = inner
    return list(model.model_fields)


def _salvaged(data: Mapping[str, Any]) -> Experiment:
    """As much of a broken config as is sound, so that its other problems are reported too."""
    kept: dict[str, Any] = {}
    for key, value in data.items():
        try:
            Experiment.model_validate({key: value})
        except ValidationError:
            continue
        kept[key] = value
    return Experiment.model_validate(kept)


def _put(tree: dict[str, Any], path: list[str], value: Any) -> None:
    for part in path[:-1]:
        tree = tree.setdefault(part, {})
    tree[path[-1]] = value


def _one_line(match: re.Match[str]) -> str:
    """An array of numbers or words on one line."""
    return "[" + ", ".join(part.strip() for part in match[1].split(",\n")) + "]"


def _without_none(value: Any) -> Any:
    if isinstance(value, dict):
        return {k: _without_none(v) for k, v in value.items() if v is not None}
    if isinstance(value, list):
        return [_without_none(v) for v in value]
    return value
