"""The whole chain with the real arm model: targets, QP, Ruckig, Zenoh, bridge, simulated YuMi."""

from __future__ import annotations

import time
from pathlib import Path

import pytest
from clothrf_zenoh.bench import ARM
from clothrf_zenoh.config import YumiZenohConfig, ZenohSection
from clothrf_zenoh.hostile import attack
from clothrf_zenoh.process import BridgeProcess
from clothrf_zenoh.robot import StreamedYumi

from clothrf_core.registry import Registry
from clothrf_core.testing.arms import CraneArms
from clothrf_core.testing.robot import check_robot

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


def test_it_is_offered_as_a_plugin():
    assert Registry.installed().find("robot", "yumi_zenoh").config is YumiZenohConfig


@pytest.mark.parametrize("seed", [0, 1])
def test_no_hostile_command_is_executed_and_every_one_is_counted(seed):
    result = attack(CraneArms(), 3_000, seed)

    assert result["executed"] == 0
    assert result["crashes"] == 0
    assert result["refused"] == 3_000
    assert result["honest_commands_accepted"] > 60
