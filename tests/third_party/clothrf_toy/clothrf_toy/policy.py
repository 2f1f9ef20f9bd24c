"""The mean of all targets relative to the anchor: what every policy must beat."""

from __future__ import annotations

from clothrf_core.errors import FeatureMismatch
from clothrf_core.files import json_bytes, npz_bytes, read_json, read_npz
from clothrf_core.types import Action


class MeanPolicy:
    def __init__(self, shrink):
        self.shrink = shrink
        self.tasks = ()

    def fit(self, view, rng):
        offsets = view.labels - view.anchors[:, None, None, :]
        self.mean = offsets.mean(axis=0) * (1.0 - self.shrink)
        self.tasks, self.names = view.tasks, view.names
        return {"leaves": 1.0}

    def act(self, features, task):
        if features.names != self.names:
            raise FeatureMismatch("expected the features of training; use the same extractor")
        return Action(features.anchor + self.mean[self.tasks.index(task)])

    def save(self, folder):
        (folder / "mean.npz").write_bytes(npz_bytes({"mean": self.mean}))
        meta = {"tasks": list(self.tasks), "names": list(self.names)}
        (folder / "mean.json").write_bytes(json_bytes(meta))

    def load(self, folder):
        loaded = MeanPolicy(self.shrink)
        meta = read_json(folder / "mean.json")
        loaded.tasks, loaded.names = tuple(meta["tasks"]), tuple(meta["names"])
        loaded.mean = read_npz(folder / "mean.npz")["mean"]
        return loaded
