"""The command line as a user meets it: what it prints, and how it fails."""

import csv
import dataclasses
import json
import os
import subprocess
import sys
import tomllib

import cv2
import numpy as np
import pytest
import tomli_w

from clothrf_core import cli
from clothrf_core.config import read_rig
from clothrf_core.locations import shipped
from clothrf_core.provider import Benchmark, Figure


def clothrf(*arguments, cwd=None):
    return subprocess.run(
        [sys.executable, "-m", "clothrf_core.cli", *map(str, arguments)],
        env={**os.environ, "COLUMNS": "200", "NO_COLOR": "1"},
        cwd=cwd,
        capture_output=True,
        text=True,
        timeout=110,
        check=False,
    )


@pytest.fixture
def call(toy, monkeypatch, capsys):
    """Run a command in this process, with the toy plugin installed."""

    def run(*arguments):
        monkeypatch.setattr(sys, "argv", ["clothrf", *map(str, arguments)])
        with pytest.raises(SystemExit) as end:
            cli.main()
        out, err = capsys.readouterr()
        return end.value.code or 0, out, err

    return run


@pytest.mark.parametrize(
    "name", ["demo.toml", "straight.toml", "three_tasks.toml", "paper_straight.toml"]
)
def test_a_shipped_config_resolves_and_prints_itself(name):
    result = clothrf("check", shipped(name))
    assert result.returncode == 0, result.stderr
    assert "[training]" in result.stdout


def test_the_default_rig_is_the_papers():
    rig = read_rig(shipped("rigs/yumi_sr300.toml"))
    assert rig.camera.K[0] == [619.986, 0.0, 311.561]
    R = np.array(rig.camera.T_world_camera)[:3, :3].T
    t = -R @ np.array(rig.camera.T_world_camera)[:3, 3]
    assert np.allclose(t, [-0.014091, -0.226336, 1.004948], atol=2e-6)


def test_a_users_mistake_is_one_message_without_a_traceback(tmp_path):
    result = clothrf("check", "nothing.toml", cwd=tmp_path)
    assert result.returncode == 2
    assert result.stderr == "clothrf: nothing.toml: no such file\n"


def test_help_names_the_daily_commands_and_those_of_plugins():
    shown = clothrf("--help").stdout
    for command in ("demo", "train", "evaluate", "check", "plugins", "doctor", "info", "predict",
                    "bridge"):  # fmt: skip
        assert f" {command} " in shown


def test_the_doctor_names_the_opencv_that_is_loaded():
    shown = clothrf("doctor").stdout
    assert f"{cv2.__version__} loaded" in shown
    assert "Vulkan for SAPIEN" in shown


def test_a_run_is_trained_evaluated_and_described(call, toy_experiment, tmp_path):
    code, out, err = call("train", toy_experiment, "--out", tmp_path / "run")
    assert code == 0, err
    assert "iteration  3" in out
    code, out, err = call("evaluate", tmp_path / "run")
    assert code == 0, err
    assert "mean grasp error" in out
    found = json.loads((tmp_path / "run" / "evaluation.json").read_text())["closed_loop"]
    assert {row["controller"] for row in found} == {"toy_mean", "expert"}
    assert all(row["mean_mm"] >= 0 for row in found)
    page = (tmp_path / "run" / "report.html").read_text()
    assert page.count("data:image/png;base64,") >= 3
    assert "data:image/gif;base64," in page
    assert "http" not in page.split("<pre>")[0]
    code, out, _ = call("info", tmp_path / "run")
    assert "48" in out


def test_training_over_an_old_run_is_refused(call, toy_experiment, tmp_path):
    call("train", toy_experiment, "--out", tmp_path / "run")
    code, _, err = call("train", toy_experiment, "--out", tmp_path / "run")
    assert code == 2
    assert "already holds a run. Go on with it: --resume" in err.replace("\n", " ")


def test_a_setting_can_be_overridden(call, toy_experiment):
    code, out, _ = call("check", toy_experiment, "--set", "training.iterations=9")
    assert code == 0
    assert "iterations = 9" in out


def test_a_bench_writes_its_figures_with_the_machine(call, toy, tmp_path, monkeypatch):
    from clothrf_core.registry import Registry

    def run(quick):
        return [Figure("speed", 2.0 if quick else 4.0, "ms", {"p99": 5.0})]

    more = dataclasses.replace(toy, benchmarks=(Benchmark("core", "speed", run),))
    monkeypatch.setattr(Registry, "installed", classmethod(lambda cls: more))
    call("bench", "core", "--json", tmp_path / "old.json")
    code, out, _ = call("bench", "core", "--quick", "--against", tmp_path / "old.json")
    assert code == 0
    written = json.loads((tmp_path / "old.json").read_text())
    assert written["figures"]["speed"] == {"value": 4.0, "unit": "ms", "detail": {"p99": 5.0}}
    assert written["machine"]["name"]
    assert "0.50" in out


@pytest.mark.parametrize(
    ("flag", "size"), [(None, "usual"), ("--quick", "quick"), ("--full", "full")]
)
def test_a_long_measurement_is_told_its_size_and_folder_and_shows_how_far_it_is(
    call, toy, monkeypatch, tmp_path, flag, size
):
    from clothrf_core.registry import Registry

    told = []

    def study(setting):
        told.append((setting.size, setting.out))
        setting.plan(200.0)
        setting.done("the first half", 100.0)
        return [Figure("speed", 1.0, "ms")]

    long = Benchmark("paper", "a study", lambda quick: [], study=study)
    more = dataclasses.replace(toy, benchmarks=(long,))
    monkeypatch.setattr(Registry, "installed", classmethod(lambda cls: more))
    code, out, _ = call("bench", "paper", "--out", tmp_path / "kept", *([flag] if flag else []))
    assert code == 0
    assert told == [(size, tmp_path / "kept")]
    assert "50 %" in out
    assert "the first half" in out


def test_a_policy_answers_a_folder_of_real_pictures(call, toy, toy_experiment, tmp_path):
    call("train", toy_experiment, "--out", tmp_path / "run")
    import clothrf_realsense

    from clothrf_core.registry import Registry

    both = Registry.of(*_toy_modules(), clothrf_realsense)
    toy_installed = classmethod(lambda cls: both)
    original = Registry.__dict__["installed"]
    Registry.installed = toy_installed
    try:
        pictures = tmp_path / "pictures"
        pictures.mkdir()
        camera = {**tomllib.loads(toy_experiment.read_text())["rig"]["camera"]}
        camera["depth_unit"] = 0.0001
        text = tomli_w.dumps({"kind": "camera", "version": 1, "camera": camera})
        (pictures / "camera.toml").write_text(text)
        for i in range(3):
            depth = np.zeros((60, 80), np.uint16)
            if i < 2:
                depth[20:40, 20:60] = 7000 + 10 * i
            cv2.imwrite(str(pictures / f"{i:03d}_depth.png"), depth)
            cv2.imwrite(str(pictures / f"{i:03d}_color.png"), np.full((60, 80, 3), 90, np.uint8))
        code, out, err = call("predict", tmp_path / "run" / "policy", pictures)
    finally:
        Registry.installed = original
    assert code == 0, err
    assert "3 frames, 1 without" in out
    table = (pictures / "predictions" / "predictions.csv").read_text()
    rows = list(csv.DictReader(table.splitlines()))
    assert [row["valid"] for row in rows] == ["true", "true", "false"]
    assert rows[2]["target0_x"] == ""
    assert abs(float(rows[0]["anchor_z"]) - 0.3) < 0.01
    assert len(list((pictures / "predictions").glob("overlay_*.png"))) == 3


def _toy_modules():
    import clothrf_toy

    from clothrf_core import builtin

    return builtin, clothrf_toy
