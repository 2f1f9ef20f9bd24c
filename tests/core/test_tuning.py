"""Cross-validation over whole roll-outs: what is tried, what is chosen, what a kill leaves."""

import csv
import json

import numpy as np
import pytest

from clothrf_core import config
from clothrf_core.errors import ConfigError
from clothrf_core.locations import shipped
from clothrf_core.provider import Setting
from clothrf_core.registry import Registry
from clothrf_core.sections import TuneSection
from clothrf_core.tuning import against, folds_of, schedule, table, tune
from clothrf_core.tuning_grid import combinations, declared

SEARCH = """
[tune]
search = "grid"
folds = 3
rollouts = 6
[tune.policy]
shrink = [0.0, 0.2, 0.4]
"""


@pytest.fixture
def experiment(toy_experiment):
    toy_experiment.write_text(toy_experiment.read_text() + SEARCH)
    return toy_experiment


def search(path, out, done=lambda what, seconds: None, **overrides):
    return tune(path, Setting(done=done), out, overrides)


def test_the_best_options_are_found_and_written_as_a_config(toy, experiment, tmp_path):
    rows = search(experiment, tmp_path / "out", **{"policy.shrink": 0.4})
    assert rows[0]["options"] == {"shrink": 0.0}
    assert [r["rms_mm"] for r in rows] == sorted(r["rms_mm"] for r in rows)
    best = config.load(tmp_path / "out" / "best.toml", toy)
    assert best.components["policy"].options.shrink == 0.0
    assert best.experiment.tune is None
    with (tmp_path / "out" / "tune.csv").open() as file:
        assert [row["options"] for row in csv.DictReader(file)][-1] == "as it is"


def test_the_config_as_it_is_takes_part_once(toy, experiment):
    resolved = config.load(experiment, toy)
    tried = combinations(resolved, toy, resolved.experiment.tune)
    assert tried == [{}, {"shrink": 0.2}, {"shrink": 0.4}]


def test_a_killed_search_ends_alike(toy, experiment, tmp_path):
    whole = search(experiment, tmp_path / "whole")
    left = 9

    def killed(what, seconds):
        nonlocal left
        left -= 1
        if left == 0:
            raise KeyboardInterrupt

    with pytest.raises(KeyboardInterrupt):
        search(experiment, tmp_path / "killed", killed)
    assert search(experiment, tmp_path / "killed") == whole
    same = [(tmp_path / name / "best.toml").read_bytes() for name in ("whole", "killed")]
    assert same[0] == same[1]


def test_another_search_is_not_mixed_in(toy, experiment, tmp_path):
    search(experiment, tmp_path / "out")
    experiment.write_text(experiment.read_text().replace("0.4]", "0.3]"))
    with pytest.raises(ConfigError, match="holds another search"):
        search(experiment, tmp_path / "out")


def test_a_roll_out_lies_in_one_fold_and_keeps_it_when_more_take_part():
    few, all_ = folds_of(60, 20, 4, seed=3), folds_of(60, 60, 4, seed=3)
    assert sorted(np.unique(few)) == [-1, 0, 1, 2, 3]
    assert (few >= 0).sum() == 20
    assert (few[few >= 0] == all_[few >= 0]).all()


def test_halving_gives_the_last_few_all_roll_outs():
    assert schedule(27, TuneSection()) == [(27, 8), (9, 20), (3, 60)]
    assert schedule(9, TuneSection(search="random")) == [(9, 60)]


def test_few_of_a_large_grid_are_drawn_alike_each_time(toy, experiment):
    text = experiment.read_text().replace('"grid"', '"random"\ncandidates = 5')
    values = [round(0.01 * i, 2) for i in range(50)]
    experiment.write_text(text.replace("[0.0, 0.2, 0.4]", str(values)))
    resolved = config.load(experiment, toy)
    first, second = (combinations(resolved, toy, resolved.experiment.tune) for _ in range(2))
    assert first == second
    assert len(first) == 5


@pytest.mark.parametrize(
    ("line", "message"),
    [
        ("shrink = [0.0, 3.0]", "tune.policy.shrink: Input should be less than or equal to 1"),
        ("shrunk = [0.0]", "tune.policy.shrunk: Extra inputs are not permitted"),
        ("shrink = 0.5", "tune.policy.shrink: expected a list of values to try, got 0.5"),
    ],
)
def test_what_cannot_be_tried_is_named(toy, experiment, tmp_path, line, message):
    experiment.write_text(experiment.read_text().replace("shrink = [0.0, 0.2, 0.4]", line))
    with pytest.raises(ConfigError, match=message):
        search(experiment, tmp_path / "out")


def test_a_policy_that_declares_nothing_needs_a_list(toy, toy_experiment, tmp_path):
    with pytest.raises(ConfigError, match="policy 'toy_mean' declares nothing to try"):
        search(toy_experiment, tmp_path / "out")


@pytest.mark.parametrize("name", ["mlp128", "extra_trees", "knn_how", "vfd_lasso"])
def test_shipped_policies_declare_what_is_worth_trying(name):
    model = Registry.installed().find("policy", name).config
    grid = declared(model)
    assert grid
    for option, values in grid.items():
        for value in values:
            model.model_validate({option: value})


def test_the_shipped_search_is_one():
    registry = Registry.installed()
    resolved = config.load(shipped("tune_three_tasks.toml"), registry)
    tried = combinations(resolved, registry, resolved.experiment.tune)
    assert tried == [{}, *({"curve_directions": n} for n in (24, 48, 64))]


def test_the_command_prints_the_search(toy, experiment, tmp_path, monkeypatch, capsys):
    import sys

    from clothrf_core import cli

    out = tmp_path / "out"
    monkeypatch.setattr(sys, "argv", ["clothrf", "tune", str(experiment), "--out", str(out)])
    with pytest.raises(SystemExit):
        cli.main()
    assert "Best config:" in capsys.readouterr().out
    assert json.loads((out / "tune.json").read_text())[0]["rollouts"] == 6


def test_a_change_is_judged_fold_by_fold():
    now = {"number": 0, "options": {}, "rollouts": 6, "each_mm": [10.0, 20.0, 30.0]}
    row = {"number": 1, "options": {"a": 1}, "rollouts": 6, "each_mm": [9.0, 19.0, 29.0]}
    row = against({**row, "rms_mm": 19.0, "nre": 0.1}, now)
    assert (row["change_mm"], row["change_half_mm"]) == (-1.0, 0.0)
    assert table([row])[1] == ["1", "a = 1", "6", "19.00", "0.1000", "-1.00 ± 0.00"]


def test_what_saw_fewer_roll_outs_is_not_compared():
    now = {"number": 0, "options": {}, "rollouts": 6, "each_mm": [10.0]}
    row = {"number": 1, "options": {"a": 1}, "rollouts": 2, "each_mm": [9.0]}
    assert against(row, now)["change_mm"] is None
