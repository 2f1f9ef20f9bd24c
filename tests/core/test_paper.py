"""The study on toy parts: its seeds, its files, what a kill leaves, what the report says."""

import csv
import json
import shutil
from pathlib import Path

import numpy as np
import pytest

from clothrf_core.dataset import read_rollout
from clothrf_core.errors import ConfigError
from clothrf_core.locations import shipped
from clothrf_core.paper import data, run
from clothrf_core.paper.fitting import auroc
from clothrf_core.paper.study import conditions, read_study
from clothrf_core.provider import Setting

STUDY = Path(__file__).with_name("paper_study.toml").read_text()


@pytest.fixture
def study(toy, toy_experiment):
    path = toy_experiment.with_name("study.toml")
    path.write_text(STUDY)
    return path


def measure(path, out, done=lambda what, seconds: None):
    return run.study(Setting("quick", done=done), path, out, workers=1)


@pytest.fixture
def finished(study, tmp_path, tmp_path_factory):
    """A finished study: measured once, a copy for every test."""
    first = tmp_path_factory.getbasetemp() / "finished_study"
    if not (first / "report.html").exists():
        measure(study, first)
    return Path(shutil.copytree(first, tmp_path / "out"))


def results(out):
    """Everything measured; what says when, where and how fast is left out."""
    kinds = ("*.npz", "cells/**/*.json", "results.json", "metrics.jsonl", "policies/**/*.json")
    found = {p for kind in kinds for p in out.rglob(kind)}
    return {str(p.relative_to(out)): p.read_bytes() for p in sorted(found)}


def test_figures_carry_the_names_of_the_table_and_their_interval(finished):
    figures = json.loads((finished / "figures.json").read_text())
    assert {
        "forest_rms_mm",
        "forest_nre",
        "forest_vs_best_baseline",
        "iterations_20_vs_1",
        "unseen_noise_growth",
        "occlusion_15_growth",
        "leaf_growth_last3",
        "ood_auroc",
    } <= set(figures)
    assert all("ci95" in figure for figure in figures.values())


def test_seeds_of_the_tests_are_none_of_training_or_choosing(finished):
    out = finished
    taught = {
        read_rollout(path).meta["seed"]
        for pattern in ("data/*/seed_*/iteration_*/*.npz", "dagger/*/dataset/*/*.npz")
        for path in out.glob(pattern)
    }
    judged = {read_rollout(p).meta["seed"] for p in out.glob("data/*/seed_*/heldout_*/*.npz")}
    assert taught == {0, 1}
    assert len(judged) == 6
    assert not taught & judged


def test_no_two_purposes_share_a_seed():
    seeds = [data.seed_of(purpose, repeat) for purpose in data.PURPOSES for repeat in range(10)]
    assert len(set(seeds)) == len(seeds)


@pytest.fixture
def unreported(monkeypatch):
    """Plots take longer than all else and are compared nowhere."""
    monkeypatch.setattr(run, "write_report", lambda space, found, made: None)


@pytest.mark.usefixtures("unreported")
def test_equal_seeds_give_equal_results_after_a_kill_too(finished, study, tmp_path):
    left = 30

    def killed(what, seconds):
        nonlocal left
        left -= 1
        if left == 0:
            raise KeyboardInterrupt

    again = tmp_path / "again"
    with pytest.raises(KeyboardInterrupt):
        measure(study, again, killed)
    assert not (again / "results.json").exists()
    measure(study, again)
    assert results(again) == results(finished)


@pytest.mark.usefixtures("unreported")
def test_a_finished_study_measures_nothing_twice(finished, study):
    out = finished
    before = {p: p.stat().st_mtime_ns for p in out.rglob("*.npz")}
    measure(study, out)
    assert {p: p.stat().st_mtime_ns for p in out.rglob("*.npz")} == before


def test_another_study_is_not_mixed_in(finished, study):
    study.write_text(study.read_text().replace("shrink = 0.5", "shrink = 0.4"))
    with pytest.raises(ConfigError, match="holds a study of another size"):
        measure(study, finished)


def test_a_default_that_changed_meanwhile_is_noticed(finished, study):
    path = finished / "experiments" / "plain.toml"
    path.write_text(path.read_text().replace("settle_s = 0.5", "settle_s = 0.4"))
    with pytest.raises(ConfigError, match="some default has changed"):
        measure(study, finished)


def test_a_controller_that_is_not_installed_is_printed_as_such(finished):
    with (finished / "tables" / "rms_mm.csv").open() as file:
        rows = {row[0]: row[1:] for row in csv.reader(file)}
    assert rows["a policy nobody has"] == ["not installed", "not installed"]
    assert "Not measured: a policy nobody has" in (finished / "REPORT.md").read_text()


def test_the_report_stands_beside_tables_and_plots(finished):
    out = finished
    assert {p.suffix for p in (out / "plots").iterdir()} == {".png", ".svg"}
    page = (out / "report.html").read_text()
    assert "Which controller to trust" in page
    assert "0.0038" in page
    assert "62 mm" in page
    assert json.loads((out / "figures.json").read_text())["forest_rms_mm"]["unit"] == "mm"


def test_levels_become_conditions(study):
    found = {c.name: c.change for c in conditions(read_study(study), quick=True)}
    assert found["noise_2"] == {"cloth": {"settle_s": 2.0}}


def test_the_area_under_the_curve_counts_ties_half():
    normal = np.array([[0.9], [0.8], [0.5]])
    assert auroc(normal, np.array([[0.1], [0.2]])) == 1.0
    assert auroc(normal, normal) == 0.5
    assert np.isclose(auroc(normal, np.array([[0.85]])), 1 / 3)


def test_the_shipped_study_is_one():
    study = read_study(shipped("paper/study.toml"))
    assert set(study.sizes) == {"quick", "usual", "full"}
    assert study.sizes["full"].seeds == 10
    assert study.sizes["full"].iterations == 20
    roles = study.roles
    assert {roles.table, roles.robust, roles.swapped, roles.swapped_robust} <= set(study.regimes)
    trained = json.dumps(study.regimes[roles.robust].change)
    unseen = [name for name, series in study.series.items() if series.unseen]
    assert len(unseen) >= 3
    assert not any(name in trained for name in unseen)
