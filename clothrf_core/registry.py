"""Finds plugins by their entry points, lists what they offer, builds what a config names.

A plugin that cannot be imported is kept as a failure and listed; it is fatal only to those who
choose it.
"""

from __future__ import annotations

import importlib.metadata
import logging
from collections.abc import Iterable, Mapping
from dataclasses import dataclass, field
from types import ModuleType
from typing import Any

import pluggy

from clothrf_core import hookspecs
from clothrf_core.errors import (
    BrokenPlugin,
    ClothrfError,
    MissingDependency,
    UnknownPlugin,
    suggestion,
)
from clothrf_core.provider import Benchmark, BuildContext, Command, Provider
from clothrf_core.rig import Section

GROUP = "clothrf"

# Kind as a config section calls it -> hook that provides it.
KINDS: Mapping[str, str] = {
    "simulator": "clothrf_simulators",
    "camera": "clothrf_cameras",
    "features": "clothrf_features",
    "policy": "clothrf_policies",
    "expert": "clothrf_experts",
    "hands": "clothrf_hands",
    "robot": "clothrf_robots",
    "randomizer": "clothrf_randomizers",
    "arm": "clothrf_arms",
    "bridge_end": "clothrf_bridge_ends",
}

logger = logging.getLogger(__name__)


@dataclass(frozen=True, slots=True)
class Failure:
    """A plugin that was found but is unusable."""

    plugin: str
    distribution: str
    reason: str


@dataclass(frozen=True, slots=True)
class Entry:
    """A provider and the distribution it came from."""

    kind: str
    provider: Provider[Any]
    plugin: str
    distribution: str


@dataclass(frozen=True)
class Registry:
    """All components that are installed.

    Attributes:
        entries: kind -> name -> entry.
        commands: sub-commands offered by plugins.
        benchmarks: measurements offered by plugins.
        failures: plugins that could not be used, with the reason.
    """

    entries: Mapping[str, Mapping[str, Entry]]
    commands: tuple[Command, ...] = ()
    benchmarks: tuple[Benchmark, ...] = ()
    failures: tuple[Failure, ...] = field(default_factory=tuple)

    @classmethod
    def installed(cls) -> Registry:
        """Everything that the installed distributions offer; imports nothing heavy."""
        modules: dict[str, tuple[Any, str]] = {}
        failures: list[Failure] = []
        for point in sorted(
            importlib.metadata.entry_points(group=GROUP), key=lambda p: (p.name, p.value)
        ):
            source = point.dist.name if point.dist is not None else "unknown"
            if point.name in modules:
                reason = f"the name is already taken by '{modules[point.name][1]}'"
                failures.append(Failure(point.name, source, reason))
                continue
            try:
                modules[point.name] = (point.load(), source)
            except Exception as error:  # noqa: BLE001  a broken plugin must not break the rest
                failures.append(Failure(point.name, source, f"{type(error).__name__}: {error}"))
        return cls._of_modules(modules, failures)

    @classmethod
    def of(cls, *modules: ModuleType | object) -> Registry:
        """A registry of the given plugin modules or objects only; for tests."""
        named = {getattr(m, "__name__", f"plugin{i}"): (m, "test") for i, m in enumerate(modules)}
        return cls._of_modules(named, [])

    @classmethod
    def _of_modules(
        cls, modules: Mapping[str, tuple[Any, str]], failures: list[Failure]
    ) -> Registry:
        entries: dict[str, dict[str, Entry]] = {kind: {} for kind in KINDS}
        commands: list[Command] = []
        benchmarks: list[Benchmark] = []
        for name, (module, source) in modules.items():
            try:
                offered = _offers(name, module)
                for kind, hook in KINDS.items():
                    for provider in offered[hook]:
                        other = entries[kind].get(provider.name)
                        if other is not None:
                            raise BrokenPlugin(
                                f"{kind} '{provider.name}' is offered by both "
                                f"'{other.distribution}' and '{source}'"
                            )
                        entries[kind][provider.name] = Entry(kind, provider, name, source)
                commands += offered["clothrf_commands"]
                benchmarks += offered["clothrf_benchmarks"]
            except Exception as error:  # noqa: BLE001  a broken plugin must not break the rest
                failures.append(Failure(name, source, f"{type(error).__name__}: {error}"))
        for failure in failures:
            logger.warning("plugin '%s' is unusable: %s", failure.plugin, failure.reason)
        return cls(entries, tuple(commands), tuple(benchmarks), tuple(failures))

    def names(self, kind: str) -> list[str]:
        """Names of all components of a kind."""
        return sorted(self.entries[kind])

    def find(self, kind: str, name: str) -> Provider[Any]:
        """The provider of `kind` called `name`.

        Raises:
            UnknownPlugin: none has that name; the message names the nearest and the broken ones.
        """
        entry = self.entries[kind].get(name)
        if entry is not None:
            return entry.provider
        message = f"no {kind} called '{name}' is installed. {suggestion(name, self.entries[kind])}"
        if self.failures:
            broken = "; ".join(f"{f.plugin} ({f.reason})" for f in self.failures)
            message += f". Plugins that failed to load: {broken}"
        raise UnknownPlugin(message)

    def build(
        self,
        kind: str,
        name: str,
        options: Section | None = None,
        context: BuildContext | None = None,
    ) -> Any:
        """Build the component `name` of `kind`.

        Raises:
            UnknownPlugin: nothing has that name.
            MissingDependency: a package it needs is not installed; names the pip extra.
            BrokenPlugin: its builder failed for another reason.
        """
        provider = self.find(kind, name)
        try:
            return provider.build(options or provider.config(), context or BuildContext())
        except ImportError as error:
            package = error.name or str(error)
            extra = f"[{provider.extra}]" if provider.extra else ""
            raise MissingDependency(
                f"{kind} '{name}' needs '{package}', which cannot be imported ({error}). "
                f"Install it with: pip install 'clothrf{extra}'"
            ) from error
        except ClothrfError:
            raise
        except Exception as error:
            raise BrokenPlugin(
                f"{kind} '{name}' failed to build: {type(error).__name__}: {error}"
            ) from error


def _offers(name: str, module: Any) -> dict[str, list[Any]]:
    """What one plugin's hooks return; a misspelt hook is an error."""
    manager = pluggy.PluginManager("clothrf")
    manager.add_hookspecs(hookspecs)
    manager.register(module, name=name)
    manager.check_pending()
    hooks: Iterable[str] = [*KINDS.values(), "clothrf_commands", "clothrf_benchmarks"]
    return {
        hook: [thing for part in getattr(manager.hook, hook)() for thing in part] for hook in hooks
    }
