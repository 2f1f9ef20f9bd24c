"""What is installed: only our names, and a third party's distribution enters by the same door."""

import importlib.metadata
import os
import subprocess
import sys
from pathlib import Path

import pytest

ROOT = Path(__file__).resolve().parent.parent
TOY = ROOT / "tests" / "third_party" / "clothrf_toy"


def test_every_importable_name_of_the_distribution_starts_with_clothrf():
    owners = importlib.metadata.packages_distributions()
    ours = [name for name, distributions in owners.items() if "clothrf" in distributions]
    assert all(name.startswith(("clothrf_", "_clothrf", "_editable")) for name in ours), ours


def clothrf(site, *arguments, cwd):
    return subprocess.run(
        [sys.executable, "-m", "clothrf_core.cli", *arguments],
        env={**os.environ, "PYTHONPATH": str(site), "COLUMNS": "200", "NO_COLOR": "1"},
        cwd=cwd,
        capture_output=True,
        text=True,
        timeout=110,
        check=False,
    )


@pytest.fixture(scope="module")
def site(tmp_path_factory):
    """A folder into which the toy distribution was really installed by pip."""
    pytest.importorskip("pip")
    pytest.importorskip("hatchling")
    target = tmp_path_factory.mktemp("site")
    command = [sys.executable, "-m", "pip", "install", "--quiet", "--no-deps", "--no-index"]
    command += ["--no-build-isolation", "--disable-pip-version-check", "--target", str(target)]
    subprocess.run([*command, str(TOY)], check=True, timeout=110)
    return target


def test_a_third_partys_plugin_is_listed(site, tmp_path):
    result = clothrf(site, "plugins", "policy", cwd=tmp_path)
    assert result.returncode == 0, result.stderr
    line = next(line for line in result.stdout.splitlines() if "toy_mean" in line)
    assert "clothrf-toy" in line


def test_a_third_partys_options_are_checked(site, tmp_path, toy_experiment):
    text = toy_experiment.read_text().replace('"toy_mean"', '"toy_mean"\nshrink = 2')
    toy_experiment.write_text(text)
    result = clothrf(site, "check", str(toy_experiment), cwd=tmp_path)
    assert result.returncode == 2
    assert "policy.shrink: Input should be less than or equal to 1 (got 2)" in result.stderr


def test_a_third_partys_policy_is_trained(site, tmp_path, toy_experiment):
    result = clothrf(site, "train", str(toy_experiment), "--out", "run", cwd=tmp_path)
    assert result.returncode == 0, result.stderr
    assert (tmp_path / "run" / "policy" / "mean.npz").exists()
    assert (tmp_path / "run" / "report.html").exists()
    shown = clothrf(site, "info", "run", cwd=tmp_path)
    assert "iteration" in shown.stdout


def test_a_broken_plugin_is_listed_and_the_rest_works(tmp_path, toy_experiment):
    site = tmp_path / "site"
    (site / "broken-1.0.dist-info").mkdir(parents=True)
    (site / "broken-1.0.dist-info" / "METADATA").write_text("Name: broken\nVersion: 1.0\n")
    (site / "broken-1.0.dist-info" / "entry_points.txt").write_text("[clothrf]\nsick = sick\n")
    (site / "sick.py").write_text("raise RuntimeError('cannot work here')\n")
    result = clothrf(site, "plugins", cwd=tmp_path)
    assert result.returncode == 0, result.stderr
    assert "failed sick (from broken): RuntimeError: cannot work here" in result.stdout
    assert "straight" in result.stdout
