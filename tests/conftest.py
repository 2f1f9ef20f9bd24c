"""Fixtures of the whole suite: a generator, a small rig, and an experiment of toy parts."""

from __future__ import annotations

import sys
from pathlib import Path

import numpy as np
import pytest

from clothrf_core.registry import Registry

ROOT = Path(__file__).resolve().parent.parent
TOY = Path(__file__).resolve().parent / "third_party" / "clothrf_toy"

TOY_EXPERIMENT = """
[rig]
name = "small"
[rig.camera]
width = 80
height = 60
K = [[60.0, 0.0, 39.5], [0.0, 60.0, 29.5], [0.0, 0.0, 1.0]]
T_world_camera = [[0.0, -1.0, 0.0, 0.5], [-1.0, 0.0, 0.0, 0.0], [0.0, 0.0, -1.0, 1.0],
                  [0.0, 0.0, 0.0, 1.0]]
[rig.hands]
rest = [[0.65, -0.14, 0.30], [0.65, 0.14, 0.30]]
[rig.grasp]
rest = [[0.35, -0.14, 0.32], [0.35, 0.14, 0.32]]
[rig.foreground]
depth_max = 0.9
low = [0.0, -0.5, 0.05]
high = [1.0, 0.5, 0.9]

[cloth]
resolution = [7, 8]

[simulator]
plugin = "toy_sheet"
[camera]
plugin = "toy_splat"
[features]
plugin = "toy_blocks"
[policy]
plugin = "toy_mean"
[tasks.ahead]
plugin = "toy_offset"
[hands]
plugin = "toy_circle"
[randomizer]
plugin = "toy_none"

[training]
iterations = 3
rollouts = 2
steps = 8
stride = 1
from_rest = 0.0
[collection]
engine = "sequential"
[evaluation]
rollouts = 2
steps = 6
seeds = 2
targets = 2
max_steps = 60
"""


@pytest.fixture
def rng() -> np.random.Generator:
    return np.random.default_rng(0)


@pytest.fixture
def toy(monkeypatch: pytest.MonkeyPatch) -> Registry:
    """A registry of the core and the toy plugin only, also for everything that asks for it."""
    from clothrf_core import builtin, compose

    monkeypatch.syspath_prepend(str(TOY))
    import clothrf_toy

    registry = Registry.of(builtin, clothrf_toy)
    assert not registry.failures, registry.failures
    monkeypatch.setattr(Registry, "installed", classmethod(lambda cls: registry))
    compose.cached_workshop.cache_clear()
    compose.cached_policy.cache_clear()
    yield registry
    compose.cached_workshop.cache_clear()
    compose.cached_policy.cache_clear()
    for name in [n for n in sys.modules if n.startswith("clothrf_toy")]:
        del sys.modules[name]


@pytest.fixture
def toy_experiment(tmp_path: Path) -> Path:
    path = tmp_path / "toy.toml"
    path.write_text(TOY_EXPERIMENT)
    return path
