"""`clothrf bridge`, `replay`, `record` and `estop`, and the files they read."""

from __future__ import annotations

import signal
import subprocess
import sys
from pathlib import Path

import pytest
from clothrf_zenoh.cli import app_of
from clothrf_zenoh.compose import bounds_of, build_arm, load_bridge, resolve_bridge
from clothrf_zenoh.config import LimitsSection
from clothrf_zenoh.faults import UnsafeExposure
from clothrf_zenoh.session import require_protection
from typer.testing import CliRunner

from clothrf_core.errors import ConfigError, UnknownPlugin
from clothrf_core.registry import Registry
from clothrf_core.testing.arms import CraneArms, crane_registry

from .processes import bridge_tables, free_port

CONFIGS = Path(__file__).parents[3] / "configs"
FILES = sorted([*CONFIGS.glob("bridge*.toml"), *(CONFIGS / "zenoh").glob("*.toml")])

BRIDGE = """
kind = "bridge"
[arm]
plugin = "yumi"
[end]
plugin = "sim"
[zenoh]
listen = ["tcp/{address}"]
"""


def complaints(tables):
    with pytest.raises(ConfigError) as caught:
        resolve_bridge(tables, crane_registry(), folder=Path(), source="robot.toml")
    return str(caught.value)


@pytest.mark.parametrize("path", FILES, ids=lambda p: p.name)
def test_every_shipped_bridge_file_is_good_and_protected(path):
    pytest.importorskip("pinocchio")
    pytest.importorskip("ruckig")
    registry = Registry.installed()
    file = load_bridge(path, registry)

    require_protection(file.config.zenoh)
    assert len(bounds_of(build_arm(file, registry), file.config.limits, 0.004).names) == 14


def test_all_problems_of_a_file_are_named_at_once():
    tables = bridge_tables(1)
    tables["limits"]["tcp_sped"] = 1.0
    tables["arm"] = {"plugin": "crane", "profile": "fast"}
    tables["end"] = {"plugin": "perfekt"}
    tables["rate_hz"] = -1.0

    assert complaints(tables).splitlines() == [
        "robot.toml: 4 problems",
        "  rate_hz: Input should be greater than 0 (got -1.0)",
        "  limits.tcp_sped: unknown key. Did you mean 'tcp_speed'? Known: "
        + ", ".join(sorted(LimitsSection.model_fields)),
        "  arm.profile: unknown key. Known: none",
        "  end.plugin: no bridge_end called 'perfekt' is installed. Did you mean 'perfect'? "
        "Known: perfect",
    ]


def test_a_file_without_an_end_names_what_is_installed():
    tables = bridge_tables(1)
    tables["end"] = {}

    assert 'end.plugin: missing; write plugin = "...". Installed: perfect' in complaints(tables)


@pytest.mark.parametrize(
    ("limits", "message"),
    [
        ({"box_low": [0.5, 0.0, 0.0], "box_high": [0.4, 1.0, 1.0]}, "expected below box_high"),
        ({"tcp_speed": 0.6, "tcp_speed_hard": 0.5}, "expected at most tcp_speed_hard 0.5"),
        ({"watchdog_s": 0.01}, "expected at least three ticks, 12 ms, found 10 ms"),
    ],
)
def test_limits_that_contradict_each_other_are_refused(limits, message):
    with pytest.raises(ConfigError, match=message):
        bounds_of(CraneArms(), LimitsSection(**limits), 0.004)


def write(folder, address):
    path = folder / "bridge.toml"
    path.write_text(BRIDGE.format(address=address))
    return path


def test_check_opens_nothing_and_says_what_it_found(tmp_path):
    pytest.importorskip("pinocchio")
    path = write(tmp_path, "127.0.0.1:1")

    result = CliRunner().invoke(app_of("bridge"), [str(path), "--check"])

    assert result.output.strip() == (
        f"{path}: good; arm yumi, end sim, tcp/127.0.0.1:1 (this machine only), 14 joints"
    )


def test_check_refuses_an_open_address(tmp_path):
    pytest.importorskip("pinocchio")
    path = write(tmp_path, "0.0.0.0:7447")

    result = CliRunner().invoke(app_of("bridge"), [str(path), "--check"])

    assert isinstance(result.exception, UnsafeExposure)
    assert "insecure = true" in str(result.exception)


def test_a_replay_without_a_recording_is_an_error_of_one_line(tmp_path):
    pytest.importorskip("pinocchio")
    path = write(tmp_path, "127.0.0.1:1")

    result = CliRunner().invoke(
        app_of("replay"), [str(tmp_path / "no.mcap"), "--bridge", str(path)]
    )

    assert "expected a recording, found no file" in str(result.exception)


def test_an_unknown_arm_is_named():
    with pytest.raises(UnknownPlugin, match="no arm called 'yummy'"):
        crane_registry().find("arm", "yummy")


def run(*words):
    command = [sys.executable, "-c", "from clothrf_core.cli import main; main()", *words]
    return subprocess.Popen(command, stdout=subprocess.PIPE, stderr=subprocess.STDOUT, text=True)


def test_the_command_starts_a_bridge_that_can_be_stopped_and_ends_with_ctrl_c(tmp_path):
    pytest.importorskip("pinocchio")
    path = write(tmp_path, f"127.0.0.1:{free_port()}")
    with run("bridge", str(path)) as bridge:
        try:
            assert bridge.stdout.readline().startswith("bridge: 250 Hz on tcp/127.0.0.1:")
            with run("estop", "--bridge", str(path)) as stop:
                said = stop.communicate(timeout=60)[0]
            bridge.send_signal(signal.SIGINT)
            rest = bridge.communicate(timeout=60)[0]
        finally:
            bridge.kill()

    assert said.strip() == "bridge: ESTOP"
    assert "emergency stop asked for by the command line" in rest
    assert "bridge: stopped after" in rest
    assert bridge.returncode == 0
