from __future__ import annotations

from clothrf_core.registry import Registry
from clothrf_core.testing.simulator import check_simulator


def test_the_simulator_keeps_every_promise_of_the_contract() -> None:
    registry = Registry.installed()

    check_simulator(lambda: registry.build("simulator", "sapien"), strain=0.03)
