"""Skips what needs a Vulkan driver, visibly, where there is none."""

from __future__ import annotations

import pytest
from clothrf_sapien.vulkan import probe


@pytest.fixture(scope="session")
def vulkan():
    report = probe()
    if not report.available:
        pytest.skip(f"no Vulkan: {report.reason}")
    return report
