"""A small data set of random numbers, and a trained toy run with everything to draw it again."""

from __future__ import annotations

import numpy as np
import pytest

from clothrf_core import config, imitation
from clothrf_core.dataset import Dataset, Rollout, write_rollout
from clothrf_core.files import names_digest
from clothrf_core.run_folder import RunFolder

NAMES = tuple(f"bin {i}" for i in range(5))
TASKS = ("straight", "bent")


def random_rollout(rng, kind, iteration, index, steps):
    return Rollout(
        features=rng.normal(size=(steps, len(NAMES))).astype(np.float32),
        valid=rng.random(steps) < 0.9,
        anchors=rng.normal(size=(steps, 3)),
        labels=rng.normal(size=(steps, len(TASKS), 2, 3)),
        executed=rng.normal(size=(steps, 2, 3)),
        grasps=rng.normal(size=(steps, 2, 3)),
        hands=rng.normal(size=(steps, 2, 3)),
        by_expert=rng.random(steps) < 0.5,
        confidence=rng.random(steps),
        feasible=rng.random(steps) < 0.9,
        meta={
            "kind": kind,
            "iteration": iteration,
            "index": index,
            "seed": 7,
            "task": TASKS[index % 2],
            "tasks": list(TASKS),
            "names": names_digest(NAMES),
            "beta": 0.8,
        },
    )


@pytest.fixture
def dataset(tmp_path, rng):
    """One held-out roll-out and three of two iterations, of different lengths."""
    made = Dataset.create(tmp_path / "dataset", NAMES, TASKS)
    for kind, iteration, index, steps in (
        ("heldout", 0, 0, 4),
        ("iteration", 1, 0, 6),
        ("iteration", 1, 1, 5),
        ("iteration", 2, 0, 7),
    ):
        path = made.path(iteration, index, kind=kind)
        write_rollout(path, random_rollout(rng, kind, iteration, index, steps))
    return made


class Silent:
    def advance(self, what):
        pass

    def finished(self, record):
        pass


@pytest.fixture
def run(toy, toy_experiment, tmp_path):
    """Two iterations of the toy experiment."""
    changes = {"training.iterations": 2, "training.rollouts": 1}
    resolved = config.load(toy_experiment, toy, changes)
    made = RunFolder.start(tmp_path / "run", resolved, resume=False)
    imitation.dagger(made, toy, Silent())
    return made


def contents(folder):
    return {
        str(p.relative_to(folder)): p.read_bytes() for p in sorted(folder.rglob("*")) if p.is_file()
    }


@pytest.fixture(name="contents")
def _contents():
    return contents
