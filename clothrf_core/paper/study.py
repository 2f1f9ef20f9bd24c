"""What a study asks: which controllers, trained and tested on what, how much of it.

A study is a folder's `study.toml` beside its `base.toml`; the core knows no controller by name.
"""

from __future__ import annotations

import copy
from dataclasses import dataclass
from pathlib import Path
from typing import Any, Literal

from pydantic import Field, ValidationError

from clothrf_core import config
from clothrf_core.errors import ConfigError
from clothrf_core.rig import Section


class SizeSection(Section):
    """`[sizes.NAME]`: how much is measured."""

    seeds: int = Field(ge=1, description="independent repetitions: data, fits and tests")
    rollouts: int = Field(ge=5, description="training roll-outs a seed")
    steps: int = Field(50, ge=1, description="samples of each")
    regimes: float = Field(1.0, gt=0.0, description="factor of the regimes' shares of them")
    shares: list[float] = Field([0.2, 0.4, 0.6, 0.8, 1.0], description="of the training roll-outs")
    test_rollouts: int = Field(ge=2, description="held-out roll-outs of the table")
    condition_rollouts: int = Field(ge=2, description="roll-outs of each hard condition")
    test_steps: int = Field(20, ge=1, description="samples of each test roll-out")
    dagger_seeds: int = Field(ge=1, description="DAgger runs of each kind")
    iterations: int = Field(20, ge=2, description="of a DAgger run")
    dagger_rollouts: int = Field(5, ge=1, description="roll-outs an iteration")
    episodes: int = Field(ge=1, description="closed-loop episodes a controller, task and seed")
    targets: int = Field(10, ge=1, description="hand targets of an episode")
    max_steps: int = Field(1500, ge=1, description="control steps of an episode at most")
    strange: int = Field(ge=2, description="pictures of each kind that no policy should trust")


class ControllerSection(Section):
    """`[controllers.NAME]`: one controller of the table."""

    title: str
    policy: dict[str, Any] = Field(description="the [policy] section of an experiment")
    columns: list[str] = Field(description="beginnings of the features it is given")
    baseline: bool = Field(True, description="the forest must beat it")
    hard: bool = Field(False, description="also trained on other regimes, tested on conditions")
    live: bool = Field(False, description="also tried in closed loop")
    whole: bool = Field(False, description="fitted on all of the data only, not on shares of it")


class RegimeSection(Section):
    """`[regimes.NAME]`: what training data look like."""

    title: str
    change: dict[str, Any] = Field({}, description="sections of base.toml that it replaces")
    share: float = Field(1.0, gt=0.0, le=1.0, description="of the size's training roll-outs")
    only: list[str] | None = Field(None, description="controllers trained on it; none = hard ones")


class SeriesSection(Section):
    """`[series.NAME]`: a condition of rising strength that trained controllers are tested on."""

    title: str
    kind: Literal["noise", "occlusion", "hands", "simulator"]
    levels: list[float] = Field(min_length=1)
    key: str = Field("", description="dotted key that takes the level; none = one level only")
    change: dict[str, Any] = Field({}, description="sections of base.toml that it replaces")
    zero: str = Field("", description="series whose first level stands for level 0 of this one")
    unseen: bool = Field(False, description="a noise family that no training data hold")
    quick: bool = Field(True, description="part of the quick form")


class DaggerSection(Section):
    """`[dagger.NAME]`: one kind of DAgger run."""

    title: str
    change: dict[str, Any] = {}
    rebuild: bool = True
    quick: bool = Field(True, description="part of the quick form")


class StrangeSection(Section):
    """`[strange.NAME]`: pictures that a policy should not trust."""

    title: str
    scene: Literal["no cloth", "arm", "as it is"] = "as it is"
    change: dict[str, Any] = {}


class RolesSection(Section):
    """`[roles]`: which controllers, regimes and series the figures are about."""

    forest: str
    table: str = Field(description="regime of the paper's table")
    robust: str = Field(description="regime meant for a real sensor")
    swapped: str = Field("", description="regime in the other simulator, without randomisation")
    swapped_robust: str = Field("", description="the same with randomisation")
    other_simulator: str = Field("", description="series tested in the other simulator")
    occlusion: str = Field("", description="series of occluders")
    unseen_level: float = Field(2.0, description="noise strength that the figure is about")
    occlusion_level: float = Field(0.15, description="share of the cloth that the figure is about")
    rebuilt: str = Field(description="DAgger run that builds the forest anew")


class PrintedSection(Section):
    """`[printed.NAME]`: a row that the paper prints, in its own unit (m^2, we suppose)."""

    title: str
    shares: list[float]
    mse: list[float]
    controller: str = Field(description="ours that stands beside it")


class Study(Section):
    """The whole of `study.toml`."""

    base: str = "base.toml"
    disturbance: float = Field(0.02, ge=0.0, description="m, OU noise of every second roll-out")
    stride: int = Field(6, ge=1, description="control steps between training samples")
    test_stride: int = Field(10, ge=1, description="control steps between test samples")
    from_rest: float = Field(0.5, ge=0.0, le=1.0, description="as [training] from_rest")
    sequence_s: float = Field(4.0, gt=0.0, description="s of each task in a sequence")
    sizes: dict[str, SizeSection]
    roles: RolesSection
    controllers: dict[str, ControllerSection]
    regimes: dict[str, RegimeSection]
    series: dict[str, SeriesSection] = {}
    dagger: dict[str, DaggerSection] = {}
    live: dict[str, Any] = Field({}, description="sections of the closed loop under noise")
    strange: dict[str, StrangeSection] = {}
    printed: dict[str, PrintedSection] = {}

    def hard(self) -> list[str]:
        """Controllers that are tested on every condition."""
        return [name for name, c in self.controllers.items() if c.hard]


@dataclass(frozen=True, slots=True)
class Condition:
    """One level of a series.

    Attributes:
        name: of its files.
        series: the series.
        level: the strength.
        change: sections of base.toml that it replaces.
    """

    name: str
    series: str
    level: float
    change: dict[str, Any]


def read_study(path: Path) -> Study:
    """The study in the file `path`.

    Raises:
        ConfigError: it is not a study; every problem is named.
    """
    try:
        return Study.model_validate(config.read_toml(path))
    except ValidationError as error:
        problems = "\n".join(
            f"  {'.'.join(map(str, e['loc']))}: {e['msg']} (got {e['input']!r})"
            for e in error.errors(include_url=False)
        )
        raise ConfigError(f"{path}: not a study\n{problems}") from error


def conditions(study: Study, *, quick: bool) -> list[Condition]:
    """All levels of all series, in order."""
    found = []
    for name, series in study.series.items():
        if quick and not series.quick:
            continue
        for level in series.levels:
            change = copy.deepcopy(series.change)
            if series.key:
                *path, last = series.key.split(".")
                tree = change
                for part in path:
                    tree = tree.setdefault(part, {})
                tree[last] = level
            found.append(Condition(f"{name}_{level:g}", name, level, change))
    return found
