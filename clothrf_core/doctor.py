"""What this machine has and lacks, each with the command that mends it."""

from __future__ import annotations

import importlib
import importlib.metadata
import platform
import subprocess
import sys
from dataclasses import dataclass

from clothrf_core.registry import Registry


@dataclass(frozen=True, slots=True)
class Finding:
    """One line of the doctor's report.

    Attributes:
        what: what was looked at.
        ok: True fine, None optional and absent, False broken.
        found: what was found.
        mend: the command or step that mends it; empty if nothing is wrong.
    """

    what: str
    ok: bool | None
    found: str
    mend: str = ""


# import name -> (distribution, extra that installs it)
PACKAGES = {
    "numba": ("numba", "fast"),
    "scipy": ("scipy", "fast"),
    "sklearn": ("scikit-learn", "forest"),
    "sapien": ("sapien", "sapien"),
    "matplotlib": ("matplotlib", "plot"),
    "loky": ("loky", "processes"),
    "pinocchio": ("pin", "yumi"),
    "ruckig": ("ruckig", "yumi"),
    "zenoh": ("eclipse-zenoh", "zenoh"),
    "distributed": ("distributed", "dask"),
    "mujoco": ("mujoco", "mujoco"),
    "pyrealsense2": ("pyrealsense2", "realsense"),
    "torch": ("torch", "torch"),
}


def examine(registry: Registry) -> list[Finding]:
    """Look at Python, packages, OpenCV, Vulkan and plugins."""
    python = sys.version_info
    findings = [
        Finding(
            "Python",
            python >= (3, 11),
            platform.python_version(),
            "" if python >= (3, 11) else "install Python 3.11 or newer",
        ),
        opencv(),
        vulkan(),
    ]
    for name, (distribution, extra) in PACKAGES.items():
        findings.append(_package(name, distribution, extra))
    for failure in registry.failures:
        findings.append(
            Finding(
                f"plugin {failure.plugin}",
                False,
                failure.reason,
                f"mend or uninstall the distribution '{failure.distribution}'",
            )
        )
    return findings


def opencv() -> Finding:
    """Which OpenCV is loaded: the headless 4.x build, or something that will fail later."""
    builds = {}
    for name in ("opencv-python-headless", "opencv-python"):
        try:
            builds[name] = importlib.metadata.version(name)
        except importlib.metadata.PackageNotFoundError:
            continue
    mend = (
        "pip uninstall -y opencv-python opencv-python-headless && "
        "pip install --no-deps opencv-python-headless==4.14.0.94"
    )
    both = ", ".join(f"{k} {v}" for k, v in builds.items()) or "no distribution"
    try:
        cv2 = importlib.import_module("cv2")
    except ImportError as error:
        return Finding("OpenCV", False, f"cannot be imported ({error}); {both}", mend)
    found = f"{cv2.__version__} loaded; {both}"
    if not hasattr(cv2, "calibrateHandEye"):
        return Finding("OpenCV", False, f"{found}; lacks calibrateHandEye", mend)
    return Finding("OpenCV", True, found)


def vulkan() -> Finding:
    """Whether SAPIEN can draw; tried in a process of its own, since a bad driver may kill it."""
    code = (
        "import sapien; s = sapien.Scene(); c = s.add_camera('c', 8, 8, 1.0, 0.1, 1.0); "
        "s.update_render(); c.take_picture(); print('drawn')"
    )
    mend = (
        "apt-get install mesa-vulkan-drivers libvulkan1 libx11-6 (Mesa >= 24.3; on Debian 12 from "
        "bookworm-backports). Without it the raster camera serves"
    )
    try:
        result = subprocess.run(
            [sys.executable, "-c", code], capture_output=True, text=True, timeout=90, check=False
        )
    except subprocess.TimeoutExpired:
        return Finding("Vulkan for SAPIEN", None, "no picture within 90 s", mend)
    if "drawn" in result.stdout:
        return Finding("Vulkan for SAPIEN", True, "draws")
    if "No module named 'sapien'" in result.stderr:
        return Finding("Vulkan for SAPIEN", None, "SAPIEN is not installed", _pip("sapien"))
    last = (result.stderr.strip().splitlines() or ["the process died"])[-1]
    return Finding("Vulkan for SAPIEN", None, last[:120], mend)


def _package(name: str, distribution: str, extra: str) -> Finding:
    try:
        return Finding(distribution, True, importlib.metadata.version(distribution))
    except importlib.metadata.PackageNotFoundError:
        return Finding(distribution, None, f"'{name}' is not installed", _pip(extra))


def _pip(extra: str) -> str:
    return f"pip install 'clothrf[{extra}]'"
