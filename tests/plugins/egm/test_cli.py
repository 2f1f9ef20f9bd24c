"""`clothrf egm-sim` as a process of its own, against a bridge end in this one."""

from __future__ import annotations

import json
import signal
import subprocess
import sys
import time

import numpy as np
import pytest

pytest.importorskip("pinocchio")

from clothrf_egm.config import EgmConfig
from clothrf_egm.end import EgmEnd

from clothrf_core.registry import Registry


def test_the_simulated_controller_asks_for_both_arms_and_stops_on_a_signal():
    ready = Registry.installed().build("arm", "yumi").ready
    with EgmEnd(EgmConfig(left_port=0, right_port=0)) as end:
        left, right = end.ports
        command = [sys.executable, "-m", "clothrf_core.cli", "egm-sim", "--json"]
        process = subprocess.Popen(
            [*command, "--left-port", str(left), "--right-port", str(right)],
            stdout=subprocess.PIPE,
            stderr=subprocess.PIPE,
            text=True,
        )
        try:
            deadline = time.monotonic() + 60.0
            while (measured := end.measured()) is None:
                assert time.monotonic() < deadline, process.poll()
                time.sleep(0.01)
            q = measured[0]
            for _ in range(50):
                q = q + 1e-4
                end.put(q, np.zeros(14))
                time.sleep(0.004)
        finally:
            process.send_signal(signal.SIGINT)
            out, errors = process.communicate(timeout=30)
    assert process.returncode == 0, errors
    np.testing.assert_allclose(measured[0], ready, atol=1e-9)
    counters = json.loads(out)
    assert counters["left_requests"] > 10
    assert counters["right_requests"] > 10
    assert 0.0 < counters["same_cycle_share"] <= 1.0
    assert counters["delay_us"] > 0.0
