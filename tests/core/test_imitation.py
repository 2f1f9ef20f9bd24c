"""The DAgger loop on toy parts: what it leaves behind, and that nothing is ever lost."""

import json
import shutil

import numpy as np
import pytest

from clothrf_core import compose, config, imitation
from clothrf_core.dataset import Dataset, read_rollout
from clothrf_core.errors import ConfigError, DataError
from clothrf_core.rollout import Mixture
from clothrf_core.run_folder import RunFolder
from clothrf_core.types import Action


class Silent:
    def advance(self, what):
        pass

    def finished(self, record):
        pass


class KilledAfter(Silent):
    def __init__(self, count):
        self.left = count

    def advance(self, what):
        self.left -= 1
        if self.left < 0:
            raise KeyboardInterrupt


def train(registry, experiment, out, progress=None, resume=False):
    resolved = config.load(experiment, registry)
    run = RunFolder.start(out, resolved, resume=resume)
    imitation.dagger(run, registry, progress or Silent())
    return run


def contents(folder):
    return {
        str(p.relative_to(folder)): p.read_bytes()
        for p in sorted(folder.rglob("*"))
        if p.is_file() and p.name not in ("versions.json", "timings.jsonl")
    }


@pytest.fixture
def run(toy, toy_experiment, tmp_path):
    return train(toy, toy_experiment, tmp_path / "run")


def test_a_run_leaves_a_record_an_iteration(run):
    records = run.metrics()
    assert [r["iteration"] for r in records] == [1, 2, 3]
    assert [r["samples"] for r in records] == [16, 32, 48]
    assert {"rms_mm", "mse_m2", "nre", "leaves", "tasks"} <= set(records[0])


def test_beta_decays_as_in_the_paper():
    assert [imitation.beta(i, 0.8) for i in (1, 2, 11)] == [1.0, 0.8, 0.8**10]


def test_the_first_iteration_is_the_experts_alone(run):
    rollout = read_rollout(run.dataset / "iteration_001" / "rollout_0000.npz")
    assert rollout.by_expert.all()


def test_later_iterations_mix_expert_and_learner(run):
    rollouts = [read_rollout(p) for p in sorted(run.dataset.glob("iteration_003/*.npz"))]
    by_expert = np.concatenate([r.by_expert for r in rollouts])
    assert 0 < by_expert.mean() < 1


def test_labels_are_the_experts_raw_targets_and_commands_are_limited(run):
    rollout = read_rollout(run.dataset / "iteration_001" / "rollout_0000.npz")
    offset = np.array([-0.3, 0.0, 0.0])
    assert np.allclose(rollout.labels[:, 0], rollout.hands + offset)
    step = np.linalg.norm(rollout.executed - rollout.grasps, axis=2)
    assert step.max() <= 0.5 / 30.0 + 1e-12


def test_the_best_policy_is_kept(run):
    records = run.metrics()
    best = imitation.best(records)
    assert min(r["rms_mm"] for r in records) == records[best - 1]["rms_mm"]
    assert contents(run.best) == contents(run.policy(best))


def test_equal_seeds_give_equal_files(run, toy, toy_experiment, tmp_path):
    again = train(toy, toy_experiment, tmp_path / "again")
    assert contents(again.dataset) == contents(run.dataset)
    assert contents(again.best) == contents(run.best)
    assert contents(again.path) == contents(run.path)


def test_another_seed_gives_other_data(run, toy, toy_experiment, tmp_path):
    text = toy_experiment.read_text() + "\n[run]\nseed = 1\n"
    toy_experiment.write_text(text)
    again = train(toy, toy_experiment, tmp_path / "again")
    assert contents(again.dataset) != contents(run.dataset)


@pytest.mark.parametrize("count", range(0, 8, 2))
def test_a_killed_run_resumes_to_the_same_bits(run, toy, toy_experiment, tmp_path, count):
    out = tmp_path / "killed"
    with pytest.raises(KeyboardInterrupt):
        train(toy, toy_experiment, out, KilledAfter(count))
    resumed = train(toy, toy_experiment, out, resume=True)
    assert contents(resumed.path) == contents(run.path)


def test_a_run_killed_at_its_very_start_goes_on(run, toy, toy_experiment, tmp_path):
    out = tmp_path / "early"
    RunFolder.start(out, config.load(toy_experiment, toy), resume=False)
    (out / "versions.json").unlink()
    resumed = train(toy, toy_experiment, out, resume=True)
    assert (out / "versions.json").exists()
    assert contents(resumed.path) == contents(run.path)


def test_what_a_killed_writer_left_is_swept_away(run, toy, toy_experiment):
    (run.path / "policies" / ".iteration_009.1.tmp").mkdir()
    (run.path / "policies" / ".iteration_009.1.tmp" / "half.npz").write_bytes(b"half")
    (run.dataset / "iteration_001" / ".rollout_0000.npz.1.tmp").write_bytes(b"half")
    before = contents(run.best)
    train(toy, toy_experiment, run.path, resume=True)
    assert not list(run.path.rglob(".*.tmp"))
    assert contents(run.best) == before


def test_a_damaged_rollout_is_made_again(run, toy, toy_experiment, tmp_path):
    out = tmp_path / "damaged"
    with pytest.raises(KeyboardInterrupt):
        train(toy, toy_experiment, out, KilledAfter(5))
    victim = out / "dataset" / "iteration_002" / "rollout_0000.npz"
    victim.write_bytes(victim.read_bytes()[:500])
    resumed = train(toy, toy_experiment, out, resume=True)
    assert contents(resumed.dataset) == contents(run.dataset)


def test_a_finished_run_is_not_overwritten(run, toy, toy_experiment):
    with pytest.raises(ConfigError, match="already holds a run. Go on with it: --resume"):
        train(toy, toy_experiment, run.path)


def test_a_run_of_another_config_is_not_resumed(run, toy, toy_experiment):
    text = toy_experiment.read_text().replace("steps = 8", "steps = 9")
    toy_experiment.write_text(text)
    with pytest.raises(ConfigError, match="was started with another config"):
        train(toy, toy_experiment, run.path, resume=True)


def test_the_number_of_workers_may_change_between_sittings(run, toy, toy_experiment):
    toy_experiment.write_text(toy_experiment.read_text().replace('"sequential"', '"dask"'))
    RunFolder.start(run.path, config.load(toy_experiment, toy), resume=True)


def test_a_folder_of_other_files_is_left_alone(toy, toy_experiment, tmp_path):
    (tmp_path / "thesis").mkdir()
    (tmp_path / "thesis" / "final.tex").write_text("...")
    with pytest.raises(ConfigError, match="expected a run folder or an empty one"):
        train(toy, toy_experiment, tmp_path / "thesis")


def test_a_policy_folder_is_enough_to_act(run, toy, tmp_path):
    moved = tmp_path / "elsewhere"
    shutil.copytree(run.best, moved)
    policy, resolved = compose.open_policy(moved, toy)
    assert policy.tasks == ("ahead",)
    assert resolved.rig.name == "small"


def test_a_foreign_folder_is_no_policy(toy, tmp_path):
    with pytest.raises(DataError, match="expected a JSON file, found none"):
        compose.open_policy(tmp_path, toy)


def test_a_policy_of_a_later_format_is_refused(run, toy):
    header = json.loads((run.best / "clothrf.json").read_text())
    (run.best / "clothrf.json").write_text(json.dumps({**header, "format": 99}))
    with pytest.raises(DataError, match="expected a policy folder of format 1"):
        compose.open_policy(run.best, toy)


def test_a_dataset_of_other_features_is_refused(run):
    with pytest.raises(DataError, match="Choose another folder"):
        Dataset.create(run.dataset, ("a", "b"), ("ahead",))


def test_a_foreign_rollout_is_named(run):
    data = Dataset.open(run.dataset)
    path = run.dataset / "iteration_001" / "rollout_0000.npz"
    np.savez(path, valid=np.ones(3, bool))
    with pytest.raises(DataError, match="rollout_0000.npz: expected a roll-out file"):
        data.view(data.paths())


def test_a_coin_chooses_one_of_the_two(rng):
    expert, learner = Action(np.zeros((2, 3))), Action(np.ones((2, 3)))
    chosen = [Mixture(0.25).act(expert, learner, rng) for _ in range(400)]
    share = np.mean([by_expert for _, by_expert in chosen])
    assert 0.18 < share < 0.32
    assert {float(a.targets[0, 0]) for a, _ in chosen} == {0.0, 1.0}


def test_a_blend_averages_the_targets(rng):
    expert, learner = Action(np.zeros((2, 3))), Action(np.ones((2, 3)))
    action, by_expert = Mixture(0.25, "blend").act(expert, learner, rng)
    assert np.allclose(action.targets, 0.75)
    assert not by_expert


def test_a_large_view_lives_in_a_file(run, monkeypatch):
    from clothrf_core import dataset

    data = Dataset.open(run.dataset)
    small = data.view(data.paths())
    monkeypatch.setattr(dataset, "MEMORY_LIMIT_BYTES", 100)
    large = data.view(data.paths())
    assert np.array_equal(large.features, small.features)
    assert (run.dataset / "cache" / "features.npy").exists()


def test_between_two_looks_time_passes_and_nothing_is_drawn(toy, toy_experiment, monkeypatch):
    from clothrf_core.rollout import RolloutJob, roll_out
    from clothrf_core.testing.fakes import SplatCamera

    drawn = []
    render = SplatCamera.render
    monkeypatch.setattr(
        SplatCamera, "render", lambda self, *a: (drawn.append(1), render(self, *a))[1]
    )
    shop = compose.workshop(config.load(toy_experiment, toy), toy)
    job = RolloutJob("", "", 0, "iteration", 1, 0, "ahead", steps=5, stride=4)
    rollout = roll_out(shop, job, None)
    assert len(rollout) == len(drawn) == 5
    assert abs(shop.world.state.time_s - 17 / 30) < 1e-9
    moved = np.linalg.norm(np.diff(rollout.hands[:, 0], axis=0), axis=1)
    assert np.allclose(moved, 0.08 * 4 / 30, rtol=0.02)


def test_a_policy_that_cannot_be_refitted_must_be_rebuilt(toy, toy_experiment, tmp_path):
    text = toy_experiment.read_text().replace("iterations = 3", "iterations = 3\nrebuild = false")
    toy_experiment.write_text(text)
    with pytest.raises(ConfigError, match="'toy_mean' has no method 'refit'"):
        train(toy, toy_experiment, tmp_path / "run")


def test_without_rebuilding_the_first_policy_is_refitted(
    toy, toy_experiment, tmp_path, monkeypatch
):
    from clothrf_toy.policy import MeanPolicy

    refitted = []

    def refit(self, view, rng):
        refitted.append(len(view))
        return self.fit(view, rng)

    monkeypatch.setattr(MeanPolicy, "refit", refit, raising=False)
    text = toy_experiment.read_text().replace("iterations = 3", "iterations = 3\nrebuild = false")
    toy_experiment.write_text(text)
    train(toy, toy_experiment, tmp_path / "run")
    assert refitted == [32, 48]
