"""Which options of a policy are worth trying, and in which combinations."""

from __future__ import annotations

import itertools
import json
from collections.abc import Mapping
from typing import Any

import numpy as np
from pydantic import BaseModel, ValidationError

from clothrf_core import config
from clothrf_core.errors import ConfigError
from clothrf_core.registry import Registry
from clothrf_core.rig import Section
from clothrf_core.sections import TuneSection

CHOOSE_STREAM = 21  # spawn key of the draw, apart from folds and fits

Options = dict[str, Any]


def combinations(
    resolved: config.Resolved, registry: Registry, section: TuneSection
) -> list[Options]:
    """What is tried, dotted option -> value; the first changes nothing.

    Raises:
        ConfigError: there is nothing to try, or a value is refused.
    """
    chosen = resolved.components["policy"]
    model = registry.find("policy", chosen.plugin).config
    grid = flat(section.policy) or declared(model)
    if not grid:
        raise ConfigError(
            f"tune: policy '{chosen.plugin}' declares nothing to try; write, for example, "
            "[tune.policy] with an option of it = [value, value]"
        )
    now = flat_values(chosen.options)
    names = list(grid)
    every = itertools.product(*(grid[name] for name in names))
    others = [dict(zip(names, values, strict=True)) for values in every]
    others = [o for o in others if any(now.get(k) != v for k, v in o.items())]
    if section.search != "grid" and len(others) > section.candidates - 1:
        seed = np.random.SeedSequence(resolved.experiment.run.seed, spawn_key=(CHOOSE_STREAM,))
        drawn = np.random.default_rng(seed).permutation(len(others))[: section.candidates - 1]
        others = [others[i] for i in np.sort(drawn)]
    tree = chosen.options.model_dump(mode="json", exclude_none=True)
    for options in others:
        try:
            model.model_validate(nested(options, tree))
        except ValidationError as error:
            problem = error.errors(include_url=False)[0]
            where = ".".join(map(str, problem["loc"]))
            raise ConfigError(f"tune.policy.{where}: {problem['msg']}") from error
    return [{}, *others]


def declared(model: type[BaseModel], prefix: str = "") -> dict[str, list[Any]]:
    """Dotted option -> values that a policy's config model declares to be worth trying."""
    grid: dict[str, list[Any]] = {}
    for name, field in model.model_fields.items():
        extra = field.json_schema_extra
        if isinstance(extra, dict) and isinstance(extra.get("tune"), list):
            grid[prefix + name] = list(extra["tune"])  # type: ignore[arg-type]
        inner = field.annotation
        if isinstance(inner, type) and issubclass(inner, Section):
            grid |= declared(inner, f"{prefix}{name}.")
    return grid


def flat(tree: Mapping[str, Any], prefix: str = "") -> dict[str, list[Any]]:
    """Dotted option -> list of values of nested tables.

    Raises:
        ConfigError: a value is no list.
    """
    grid: dict[str, list[Any]] = {}
    for name, values in tree.items():
        if isinstance(values, Mapping):
            grid |= flat(values, f"{prefix}{name}.")
        elif isinstance(values, list) and values:
            grid[prefix + name] = values
        else:
            raise ConfigError(
                f"tune.policy.{prefix}{name}: expected a list of values to try, got {values!r}"
            )
    return grid


def flat_values(options: Section, prefix: str = "") -> Options:
    """Dotted option -> present value."""
    found: Options = {}
    for name in type(options).model_fields:
        value = getattr(options, name)
        if isinstance(value, Section):
            found |= flat_values(value, f"{prefix}{name}.")
        else:
            found[prefix + name] = value
    return found


def nested(options: Mapping[str, Any], tree: Mapping[str, Any]) -> dict[str, Any]:
    """`tree` with dotted `options` put in."""
    result: dict[str, Any] = json.loads(json.dumps(tree))
    for dotted, value in options.items():
        *path, last = dotted.split(".")
        place = result
        for part in path:
            place = place.setdefault(part, {})
        place[last] = value
    return result
