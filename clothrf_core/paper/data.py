"""Roll-outs of a study: what is learnt from, and what is judged on, from seeds of their own."""

from __future__ import annotations

import copy
import dataclasses
import functools
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np

from clothrf_core import compose, config
from clothrf_core.dataset import Dataset, read_rollout
from clothrf_core.errors import ConfigError, FeatureMismatch
from clothrf_core.expert_data import expert_jobs
from clothrf_core.files import atomic_write
from clothrf_core.paper.study import SizeSection, Study
from clothrf_core.registry import Registry
from clothrf_core.rollout import RolloutJob
from clothrf_core.types import DatasetView

# A thousand seeds for every purpose: nothing is judged on what it was taught or chosen on.
PURPOSES = ("train", "test", "condition", "episode", "strange")


def seed_of(purpose: str, repeat: int) -> int:
    """The seed of repetition 0, 1, ... for one purpose."""
    return 1000 * PURPOSES.index(purpose) + repeat


@dataclass(frozen=True)
class Workspace:
    """A study at work in its folder.

    Attributes:
        out: the folder.
        study: what is asked.
        size: how much of it.
        base: the experiment that everything is a change of.
        registry: what is installed.
        quick: the quick form.
    """

    out: Path
    study: Study
    size: SizeSection
    base: Path
    registry: Registry
    quick: bool

    def experiment(self, name: str) -> Path:
        """The file of the resolved experiment `name`."""
        return self.out / "experiments" / f"{name}.toml"

    def prepare(self, name: str, change: Mapping[str, Any]) -> Path:
        """Write the experiment `name`, a change of the base, or see that it is still the same.

        Raises:
            ConfigError: it is not, because some default of a plugin has changed since.
        """
        path = self.experiment(name)
        resolved = config.load(self.base, self.registry, copy.deepcopy(dict(change)))
        text = resolved.text.encode()
        if path.exists() and path.read_bytes() != text:
            raise ConfigError(
                f"{path}: was resolved otherwise when the study began; some default has changed "
                "since. Choose another folder with --out"
            )
        path.parent.mkdir(parents=True, exist_ok=True)
        atomic_write(path, text)
        return path

    def dataset(self, name: str, repeat: int) -> Dataset:
        """The data set `name` of one repetition; made if it is not there."""
        names, tasks = layout(self.experiment(name))
        return Dataset.create(self.out / "data" / name / f"seed_{repeat}", names, tasks)


@functools.cache
def layout(path: Path) -> tuple[tuple[str, ...], tuple[str, ...]]:
    """Feature names and tasks of an experiment file, which never changes once it is written."""
    registry = Registry.installed()
    resolved = config.load(path, registry)
    return compose.extractor(resolved, registry).names, resolved.task_names


def training(space: Workspace, name: str, repeat: int, rollouts: int) -> list[RolloutJob]:
    """Roll-outs to learn from."""
    study, size = space.study, space.size
    return expert_jobs(
        space.experiment(name),
        space.dataset(name, repeat),
        seed=seed_of("train", repeat),
        kind="iteration",
        count=rollouts,
        steps=size.steps,
        stride=study.stride,
        disturbance=study.disturbance,
        from_rest=study.from_rest,
    )


def testing(
    space: Workspace, name: str, repeat: int, rollouts: int, *, purpose: str
) -> list[RolloutJob]:
    """Roll-outs to be judged on, samples farther apart in time."""
    study, size = space.study, space.size
    return expert_jobs(
        space.experiment(name),
        space.dataset(name, repeat),
        seed=seed_of(purpose, repeat),
        kind="heldout",
        count=rollouts,
        steps=size.test_steps,
        stride=study.test_stride,
        disturbance=study.disturbance,
        from_rest=study.from_rest,
    )


@functools.lru_cache(maxsize=1)
def training_view(folder: str) -> DatasetView:
    """All training rows of a data set; kept for the next fit on it."""
    data = Dataset.open(Path(folder))
    return data.view(data.paths())


@functools.lru_cache(maxsize=64)
def test_view(folder: str) -> DatasetView:
    """All test rows of a data set; kept for the next controller."""
    data = Dataset.open(Path(folder))
    return data.view(data.paths(kind="heldout"))


def leaders(folder: str) -> list[str]:
    """The task that led each training roll-out."""
    data = Dataset.open(Path(folder))
    return [str(read_rollout(path).meta["task"]) for path in data.paths()]


def columns(view: DatasetView, beginnings: Sequence[str]) -> DatasetView:
    """The features whose names begin with one of `beginnings`, in the order of the view.

    Raises:
        FeatureMismatch: there are none.
    """
    index = np.array([i for i, n in enumerate(view.names) if n.startswith(tuple(beginnings))])
    if index.size == 0:
        raise FeatureMismatch(
            f"expected features that begin with {', '.join(beginnings)}, found none among "
            f"{len(view.names)} like '{view.names[0]}'"
        )
    if index.size == len(view.names):
        return view
    return dataclasses.replace(
        view, features=view.features[:, index], names=tuple(view.names[i] for i in index)
    )


def readable(names: Sequence[str], beginnings: Sequence[str]) -> bool:
    """Whether there are features for each of `beginnings`."""
    return all(any(name.startswith(b) for name in names) for b in beginnings)


def tasks(view: DatasetView, wanted: Sequence[str]) -> DatasetView:
    """The labels of some tasks only; all of them if `wanted` is empty."""
    if not wanted or tuple(wanted) == view.tasks:
        return view
    index = [view.tasks.index(task) for task in wanted]
    return dataclasses.replace(view, labels=view.labels[:, index], tasks=tuple(wanted))
