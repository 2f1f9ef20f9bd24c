"""The model and the simulated end against the suites that every plugin of their kind passes."""

from __future__ import annotations

import pytest

pytest.importorskip("pinocchio")

from clothrf_yumi.config import YumiConfig

from clothrf_core.registry import Registry
from clothrf_core.testing.arm_model import check_arm_model, check_bridge_end
from clothrf_core.testing.arms import CraneArms


@pytest.mark.parametrize("profile", ["normal", "commissioning"])
def test_the_yumi_keeps_the_contract(profile):
    config = YumiConfig(profile=profile)
    check_arm_model(lambda: Registry.installed().build("arm", "yumi", config))


def test_the_simulated_end_keeps_the_contract():
    check_bridge_end(lambda: Registry.installed().build("bridge_end", "sim"), joints=14)


def test_an_arm_that_ignores_its_limits_breaks_the_contract():
    class Wild(CraneArms):
        def solve(self, q, targets, dt):
            return super().solve(q, targets, 10.0 * dt)

    with pytest.raises(AssertionError, match="too fast"):
        check_arm_model(Wild)
