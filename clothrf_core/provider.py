"""What a plugin hands to the core: a name, a config model and a function that builds the thing."""

from __future__ import annotations

from collections.abc import Callable, Mapping
from dataclasses import dataclass, field
from pathlib import Path
from typing import TYPE_CHECKING, Any, Generic, Literal, TypeVar

from clothrf_core.rig import Rig, Section

if TYPE_CHECKING:
    import typer

    from clothrf_core.interfaces import World
    from clothrf_core.registry import Registry

ThingT = TypeVar("ThingT", covariant=True)


class NoOptions(Section):
    """The config of a component that has nothing to configure."""


@dataclass(frozen=True, slots=True)
class BuildContext:
    """What a component may need besides its own config.

    Attributes:
        rig: the rig of the experiment; None where a component is built on its own.
        world: the simulated world, for rendered cameras and simulated robots.
        folder: folder that relative paths of the config start from.
        registry: for components made of other components (a sequence of experts, an arm model).
    """

    rig: Rig | None = None
    world: World | None = None
    folder: Path = field(default_factory=Path)
    registry: Registry | None = None


@dataclass(frozen=True, slots=True)
class Provider(Generic[ThingT]):
    """One component that a plugin offers.

    Attributes:
        name: what a config's ``plugin = "..."`` says; unique within its kind.
        summary: one line for `clothrf plugins`.
        build: makes the component from its validated config; the place of heavy imports.
        config: pydantic model of its section, ``extra="forbid"``.
        extra: the pip extra that installs what `build` imports; empty if none is needed.
    """

    name: str
    summary: str
    build: Callable[[Any, BuildContext], ThingT]
    config: type[Section] = NoOptions
    extra: str = ""


@dataclass(frozen=True, slots=True)
class Command:
    """A sub-command of `clothrf`.

    Attributes:
        name: as typed.
        summary: one line of `clothrf --help`.
        load: imports and returns its typer application; called only when the command is used.
    """

    name: str
    summary: str
    load: Callable[[], typer.Typer]


@dataclass(frozen=True, slots=True)
class Figure:
    """One measured number of a benchmark.

    Attributes:
        name: as in the table of figures.
        value: the number (a median unless the name says otherwise).
        unit: its unit.
        detail: p99, ratios against peers and whatever else belongs beside it.
    """

    name: str
    value: float
    unit: str
    detail: Mapping[str, Any] = field(default_factory=dict)


@dataclass(frozen=True, slots=True)
class Setting:
    """How a long measurement is made.

    Attributes:
        size: how much of it: quick, usual or full.
        out: where it keeps its work and goes on after a kill; None = where it always does.
        plan: told how much work is ahead, in rough seconds.
        done: told what is behind: its name and rough seconds.
    """

    size: Literal["quick", "usual", "full"] = "usual"
    out: Path | None = None
    plan: Callable[[float], None] = lambda _: None
    done: Callable[[str, float], None] = lambda _, __: None


@dataclass(frozen=True, slots=True)
class Benchmark:
    """A measurement of `clothrf bench GROUP`.

    Attributes:
        group: core, robot, loop, scale or paper.
        name: what it measures.
        run: does it; gets True for the quick form, returns its figures.
        needs: what it cannot run without (``vulkan``, an extra); printed when it is skipped.
        study: does it at length instead of `run`, in a folder, with progress.
    """

    group: str
    name: str
    run: Callable[[bool], list[Figure]]
    needs: str = ""
    study: Callable[[Setting], list[Figure]] | None = None
