"""One line of a config chooses this simulator, and everything else goes on as before."""

from __future__ import annotations

import pytest

from clothrf_core import compose, config, imitation
from clothrf_core.locations import shipped
from clothrf_core.registry import Registry
from clothrf_core.run_folder import RunFolder

pytest.importorskip("mujoco", reason="needs the extra 'mujoco'")

EXPERIMENT = f"""
[rig]
file = "{shipped("rigs/yumi_sr300.toml")}"
[camera]
plugin = "raster"
[policy]
plugin = "ridge"
[tasks.straight]
plugin = "straight"
[cloth]
resolution = [11, 12]
settle_s = 0.2
[training]
iterations = 1
rollouts = 2
steps = 5
[collection]
engine = "sequential"
[evaluation]
rollouts = 2
steps = 5
"""


class Silent:
    def advance(self, what):
        pass

    def finished(self, record):
        pass


@pytest.fixture
def registry():
    compose.cached_workshop.cache_clear()
    compose.cached_policy.cache_clear()
    yield Registry.installed()
    compose.cached_workshop.cache_clear()
    compose.cached_policy.cache_clear()


def trained(registry, folder, simulator):
    folder.mkdir()
    experiment = folder / "experiment.toml"
    experiment.write_text(EXPERIMENT + simulator)
    resolved = config.load(experiment, registry)
    run = RunFolder.start(folder / "run", resolved, resume=False)
    imitation.dagger(run, registry, Silent())
    return resolved, run


def test_a_run_is_trained_in_mujoco_by_one_line_more(registry, tmp_path):
    line = '[simulator]\nplugin = "mujoco"\n'
    resolved, run = trained(registry, tmp_path / "mujoco", line)
    _, first = trained(registry, tmp_path / "first", "")

    assert resolved.components["simulator"].plugin == "mujoco"
    assert [r["samples"] for r in run.metrics()] == [10]
    assert run.metrics()[0].keys() == first.metrics()[0].keys()
    assert 0.0 < run.metrics()[0]["rms_mm"] != first.metrics()[0]["rms_mm"]
