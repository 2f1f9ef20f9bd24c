"""Finding out whether SAPIEN can draw, and saying so where it cannot."""

from __future__ import annotations

import os
import subprocess
import sys

import pytest
from clothrf_sapien import vulkan
from clothrf_sapien.vulkan import probe

BLIND = {"VK_ICD_FILENAMES": "/nonexistent.json", "VK_DRIVER_FILES": "/nonexistent.json"}


def test_without_a_driver_the_probe_says_what_is_missing_and_how_to_mend_it(monkeypatch):
    for name, value in BLIND.items():
        monkeypatch.setenv(name, value)

    report = probe()

    assert not report.available
    assert report.device == ""
    assert report.reason.startswith("SAPIEN finds no device to draw with (RuntimeError:")
    assert "apt-get install -t bookworm-backports mesa-vulkan-drivers" in report.reason
    assert "libvulkan1" in report.reason


def test_without_a_driver_the_camera_refuses_with_the_same_advice():
    code = (
        "import numpy as np\n"
        "from clothrf_core.errors import MissingDependency\n"
        "from clothrf_core.scene import Scene\n"
        "from clothrf_core.testing.camera import example_camera\n"
        "from clothrf_sapien.camera import SapienCamera\n"
        "from clothrf_sapien.camera_config import SapienCameraConfig\n"
        "with SapienCamera(SapienCameraConfig()) as camera:\n"
        "    try:\n"
        "        camera.render(Scene(meshes=()), example_camera())\n"
        "    except MissingDependency as error:\n"
        "        print(error)\n"
    )
    done = subprocess.run(
        [sys.executable, "-c", code], capture_output=True, text=True, env={**os.environ, **BLIND}
    )

    assert done.stdout.startswith("camera 'sapien' needs a Vulkan driver, and SAPIEN says: ")
    assert "bookworm-backports" in done.stdout


@pytest.mark.parametrize(
    ("program", "expected"),
    [
        ("import os; os.abort()", "it was killed by signal 6"),
        (
            "raise ModuleNotFoundError(\"No module named 'sapien'\")",
            "pip install 'clothrf[sapien]'",
        ),
        ("import time; time.sleep(60)", "SAPIEN did not start within 1 s"),
    ],
)
def test_a_crash_a_missing_package_and_a_hang_are_answers(monkeypatch, program, expected):
    monkeypatch.setattr(vulkan, "PROBE", program)

    report = probe(timeout_s=1.0 if "sleep" in program else 60.0)

    assert not report.available
    assert expected in report.reason


@pytest.mark.vulkan
def test_with_a_driver_the_probe_names_the_device(vulkan):
    assert vulkan.available
    assert vulkan.device
    assert vulkan.reason == ""
