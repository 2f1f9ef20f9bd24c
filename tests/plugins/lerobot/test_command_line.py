"""`clothrf export` and `clothrf import` as typed."""

import sys

import pytest
from clothrf_lerobot import clothrf_commands
from typer.testing import CliRunner

from clothrf_core import cli
from clothrf_core.errors import MissingDependency


def call(name, *arguments):
    [command] = [c for c in clothrf_commands() if c.name == name]
    result = CliRunner().invoke(command.load(), [str(a) for a in arguments])
    if result.exception and not isinstance(result.exception, SystemExit):
        raise result.exception
    return result.output


def test_a_run_goes_out_and_comes_back(run, toy, tmp_path, contents):
    assert "4 episodes written" in call("export", run.path, tmp_path / "out")
    assert "0 episodes written, 4 were there" in call("export", run.path, tmp_path / "out")
    output = call("import", tmp_path / "out", tmp_path / "back")
    assert "4 roll-outs, 2 of them held out, 28 rows, ahead" in output
    assert contents(tmp_path / "back") == contents(run.dataset)


def test_a_strangers_options_reach_the_reader(run, toy, tmp_path):
    call("export", run.path, tmp_path / "out")
    output = call(
        "import", tmp_path / "out", tmp_path / "back", "--held-out", 0.5,
        "--map", "features=observation.state", "--map", "labels=clothrf.executed",
        "--task", "ahead",
    )  # fmt: skip
    assert "4 roll-outs, 2 of them held out" in output


def test_mcap_is_a_format(run, toy, tmp_path):
    pytest.importorskip("mcap_ros2")
    assert "4 episodes" in call("export", run.path, tmp_path / "a.mcap", "--format", "mcap")


def test_a_missing_package_is_named_with_its_extra(run, toy, tmp_path, monkeypatch):
    monkeypatch.setitem(sys.modules, "pyarrow", None)
    with pytest.raises(MissingDependency, match=r"pip install 'clothrf\[lerobot\]'"):
        call("export", run.path, tmp_path / "out")


def test_train_learns_from_a_data_set_alone(
    run, toy, toy_experiment, tmp_path, monkeypatch, capsys
):
    call("export", run.path, tmp_path / "out")
    call("import", tmp_path / "out", tmp_path / "back")
    out = tmp_path / "cloned"
    words = ["train", toy_experiment, "--data", tmp_path / "back", "--out", out]
    monkeypatch.setattr(sys, "argv", ["clothrf", *map(str, words)])
    with pytest.raises(SystemExit) as end:
        cli.main()
    assert not end.value.code
    assert "16 samples" in capsys.readouterr().out
    assert not (out / "dataset").exists()
    assert (out / "policy" / "clothrf.json").exists()
    assert (out / "report.html").exists()
