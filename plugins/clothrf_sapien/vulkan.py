"""Whether SAPIEN can draw on this machine, found out without risking the process that asks."""

from __future__ import annotations

import subprocess
import sys
from dataclasses import dataclass

PROBE = """
import sapien
import sapien.render
sapien.render.RenderSystem()
lines = [line for line in str(sapien.render.get_device_summary()).splitlines() if "GPU" in line]
print("\\nDEVICE " + (lines[0].split(":", 1)[1].strip() if lines else "unnamed"))
"""

MEND = (
    "install a Vulkan driver: 'apt-get install libvulkan1 libx11-6 mesa-vulkan-drivers', on "
    "Debian 12 with bookworm-backports enabled and "
    "'apt-get install -t bookworm-backports mesa-vulkan-drivers' (Mesa >= 24.3 is needed); with an "
    "NVIDIA GPU its own driver. Without one, the camera 'raster' draws the same pictures"
)


@dataclass(frozen=True, slots=True)
class VulkanReport:
    """What a probe found.

    Attributes:
        available: SAPIEN can draw here.
        device: name of the device it would draw on; empty if there is none.
        reason: why it cannot draw, and what to do about it; empty if it can.
    """

    available: bool
    device: str = ""
    reason: str = ""


def probe(*, timeout_s: float = 60.0) -> VulkanReport:
    """Start SAPIEN's renderer in a process of its own; a crash there is an answer, not a crash."""
    try:
        done = subprocess.run(
            [sys.executable, "-c", PROBE],
            capture_output=True,
            text=True,
            timeout=timeout_s,
            check=False,
        )
    except subprocess.TimeoutExpired:
        return VulkanReport(False, reason=f"SAPIEN did not start within {timeout_s:g} s; {MEND}")
    named = [line for line in done.stdout.splitlines() if line.startswith("DEVICE ")]
    if done.returncode == 0 and named:
        return VulkanReport(True, device=named[-1].removeprefix("DEVICE "))
    return VulkanReport(False, reason=_reason(done.returncode, done.stderr))


def _reason(code: int, stderr: str) -> str:
    lines = [line.strip() for line in stderr.splitlines() if line.strip()]
    last = lines[-1] if lines else "no message"
    if "No module named" in last:
        return f"SAPIEN is not installed ({last}). Install it with: pip install 'clothrf[sapien]'"
    died = f"it was killed by signal {-code}" if code < 0 else last
    return f"SAPIEN finds no device to draw with ({died}); {MEND}"
