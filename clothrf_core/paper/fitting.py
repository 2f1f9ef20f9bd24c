"""One controller fitted on one data set and judged on others."""

from __future__ import annotations

import json
import time
from collections.abc import Mapping
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np

from clothrf_core import compose, config
from clothrf_core.dataset import Dataset, read_rollout
from clothrf_core.evaluation import confidence_curve, judged, predictions
from clothrf_core.interfaces import Policy
from clothrf_core.paper import data
from clothrf_core.registry import Registry
from clothrf_core.types import DatasetView, Features, Float

FIT_STREAM = 11  # spawn key of the fits, apart from roll-outs and DAgger


@dataclass(frozen=True, slots=True)
class FitJob:
    """One fit and its tests.

    Attributes:
        label: how messages call it.
        config: resolved experiment of the data.
        policy: JSON of the [policy] section.
        columns: beginnings of the features that the policy is given.
        train: folder of the training data set.
        rollouts: how many of its roll-outs, from the first on.
        seed: of the fit.
        tests: (name, folder) of the data sets it is judged on.
        tasks: of the policy; empty = all.
        own: learn only from roll-outs that one of `tasks` led.
        strange: (name, folder) of pictures it should not trust.
        keep: folder to save the policy in; empty = forget it.
    """

    label: str
    config: str
    policy: str
    columns: tuple[str, ...]
    train: str
    rollouts: int
    seed: int
    tests: tuple[tuple[str, str], ...]
    tasks: tuple[str, ...] = ()
    own: bool = False
    strange: tuple[tuple[str, str], ...] = ()
    keep: str = ""

    @property
    def name(self) -> str:
        """How messages call it."""
        return self.label

    def run(self) -> dict[str, Any]:
        """Samples, what the fit says of itself, errors on every test, AUROC on strange pictures."""
        registry = Registry.installed()
        change = {"policy": json.loads(self.policy)}
        resolved = config.load(Path(self.config), registry, change)
        policy = compose.new_policy(resolved, registry)
        view = self._rows()
        rng = np.random.default_rng(np.random.SeedSequence(self.seed, spawn_key=(FIT_STREAM,)))
        start = time.perf_counter()
        facts = {k: float(v) for k, v in policy.fit(view, rng).items() if not k.endswith("_s")}
        fitted = time.perf_counter()
        tests, curve = {}, np.zeros((0, 3))
        rows = 0
        for number, (name, folder) in enumerate(self.tests):
            test = data.tasks(data.columns(data.test_view(folder), self.columns), self.tasks)
            targets, sure = predictions(policy, test)
            tests[name] = judged(test, targets, sure)
            rows += len(test) * len(test.tasks)
            if number == 0:
                curve = confidence_curve(test.labels, targets, sure)
        asked = time.perf_counter()
        strange = {}
        if self.strange:
            normal = trust(policy, self.tests[0][1], self.columns)
            for name, folder in self.strange:
                strange[name] = auroc(normal, trust(policy, folder, self.columns))
        if self.keep:
            compose.save_policy(Path(self.keep), policy, resolved, view.names)
        return {
            "samples": len(view),
            "facts": facts,
            "tests": tests,
            "auroc": strange,
            "confidence_curve": curve.tolist(),
            "seconds": {"fit": fitted - start, "act_us": 1e6 * (asked - fitted) / max(rows, 1)},
        }

    def _rows(self) -> DatasetView:
        view = data.columns(data.training_view(self.train), self.columns)
        chosen = np.asarray(view.groups) < self.rollouts
        if self.own:
            led = np.array([task in self.tasks for task in data.leaders(self.train)])
            chosen &= led[np.asarray(view.groups)]
        if not chosen.all():
            view = view.rows(chosen)
        return data.tasks(view, self.tasks)


def trust(policy: Policy, folder: str, beginnings: tuple[str, ...]) -> Float:
    """(N, T) confidence on the pictures of a data set; 0 where the extractor saw no cloth."""
    dataset = Dataset.open(Path(folder))
    index = np.array([i for i, n in enumerate(dataset.names) if n.startswith(beginnings)])
    names = tuple(dataset.names[i] for i in index)
    found = []
    for path in dataset.paths(kind="heldout"):
        rollout = read_rollout(path)
        for i in range(len(rollout)):
            if not rollout.valid[i]:
                found.append([0.0] * len(policy.tasks))
                continue
            seen = Features(rollout.features[i, index], names, rollout.anchors[i])
            found.append([policy.act(seen, task).confidence for task in policy.tasks])
    return np.array(found)


def auroc(normal: Float, strange: Float) -> float:
    """Chance that a normal picture is trusted more than a strange one; equal trust counts half.

    Both are (N, T); the mean over tasks of the area under the ROC curve (Mann and Whitney 1947).
    """
    areas = []
    for high, low in zip(normal.T, strange.T, strict=True):
        order = np.sort(low)
        below = np.searchsorted(order, high, side="left")
        equal = np.searchsorted(order, high, side="right") - below
        areas.append(float((below + 0.5 * equal).mean() / len(order)))
    return float(np.mean(areas))


def section(policy: Mapping[str, Any]) -> str:
    """A [policy] section as the plain text that travels to a worker."""
    return json.dumps(dict(policy), sort_keys=True)
