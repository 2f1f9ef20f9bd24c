"""The whole chain with the real arm model: targets, QP, Ruckig, Zenoh, bridge, simulated YuMi."""

from __future__ import annotations

import time
from pathlib import Path

import pytest
from clothrf_zenoh.bench import ARM
from clothrf_zenoh.config import YumiZenohConfig, ZenohSection
from clothrf_zenoh.hostile import attack
from clothrf_zenoh.process import BridgeProcess
from clothrf_zenoh.replay import read_commands
from clothrf_zenoh.robot import StreamedYumi

from clothrf_core.registry import Registry
from clothrf_core.testing.arms import CraneArms
from clothrf_core.testing.robot import check_robot
from clothrf_core.types import RobotCommand

from .processes import bridge_tables, free_port

pytest.importorskip("pinocchio")
pytest.importorskip("ruckig")


class Paced(StreamedYumi):
    """Sends at 30 Hz, as the control loop does."""

    def send(self, command):
        time.sleep(1 / 30)
        return super().send(command)


def test_the_streamed_yumi_keeps_a_robots_promises():
    port = free_port()
    tables = bridge_tables(port) | {"arm": dict(ARM), "end": {"plugin": "sim"}}
    config = YumiZenohConfig(
        arm=dict(ARM),
        zenoh=ZenohSection(connect=[f"tcp/127.0.0.1:{port}"], lease_s=2.0),
        lease_s=1.5,
        realtime_priority=0,
    )

    with BridgeProcess(tables, folder=Path()) as far:
        check_robot(lambda: Paced(config, folder=Path()))

    assert far.last_status["accepted"] > 100
    assert not [name for name in far.last_status if name.startswith("stopped")]


def test_one_robot_section_brings_up_bridge_controllers_and_recorder(tmp_path):
    if "egm" not in Registry.installed().names("bridge_end"):
        pytest.skip("no EGM end is installed")
    port, left, right = free_port(), free_port(), free_port()
    (tmp_path / "bridge.toml").write_text(
        f"""
        [arm]
        plugin = "yumi"
        [end]
        plugin = "egm"
        left_port = {left}
        right_port = {right}
        [zenoh]
        listen = ["tcp/127.0.0.1:{port}"]
        [limits]
        watchdog_s = 0.5
        max_age_s = 0.5
        max_gap_s = 0.5
        """
    )
    config = YumiZenohConfig(
        zenoh=ZenohSection(connect=[f"tcp/127.0.0.1:{port}"], lease_s=2.0),
        lease_s=1.5,
        bridge="bridge.toml",
        record="run.mcap",
        state_timeout_s=20.0,
        realtime_priority=0,
    )

    with Paced(config, folder=tmp_path) as robot:
        home = robot.state().positions
        for number in range(20):
            robot.send(RobotCommand(number, 0, 0.3, home + [0.0, 0.0, 0.01]))
        status = robot.status()

    assert status["stream"] == "streaming"
    assert status["why"] == ""
    names = Registry.installed().build("arm", "yumi").joint_names
    assert len(read_commands(tmp_path / "run.mcap", tuple(names)).times_ns) > 50


def test_it_is_offered_as_a_plugin():
    assert Registry.installed().find("robot", "yumi_zenoh").config is YumiZenohConfig


@pytest.mark.parametrize("seed", [0, 1])
def test_no_hostile_command_is_executed_and_every_one_is_counted(seed):
    result = attack(CraneArms(), 3_000, seed)

    assert result["executed"] == 0
    assert result["crashes"] == 0
    assert result["refused"] == 3_000
    assert result["honest_commands_accepted"] > 60
