"""Config sections of the arm model and of the simulated end of the bridge."""

from __future__ import annotations

from typing import Literal

from pydantic import Field

from clothrf_core.rig import Section, Vector


class YumiConfig(Section):
    """The YuMi's kinematics and limits."""

    profile: Literal["normal", "commissioning"] = Field(
        "commissioning", description="speeds, accelerations and jerks of all motion"
    )
    table_height: float | None = Field(
        None, description="z of the table top, m; none = the rig's table, or -0.02 without a rig"
    )
    tool: float = Field(
        0.1142, gt=0.0, lt=0.3, description="grasp point's distance from the flange, m"
    )
    pitch: float = Field(
        1.4, ge=-1.6, le=2.4, description="at rest tools point forward and this far down, rad"
    )
    lean: float = Field(
        3.5, ge=0.0, description="and tip towards the body when nearer to it, rad/m"
    )
    orientation: float = Field(
        0.3, ge=0.0, description="weight of the tools' orientation, m/rad; 0 = free to turn"
    )
    posture: float = Field(1e-3, gt=0.0, description="weight of the ready posture, m/rad")
    clearance: float = Field(
        0.030, ge=0.0, lt=0.05, description="arms are steered to keep this distance, m"
    )
    padding: float = Field(0.01, ge=0.0, description="body and table count as this much thicker, m")
    jump: float = Field(0.1, gt=0.0, description="targets farther from the gripper are refused, m")
    reach: float = Field(0.01, gt=0.0, description="targets missed by more are refused, m")
    box_low: Vector = Field([0.10, -0.60, 0.0], description="lowest corner of allowed targets, m")
    box_high: Vector = Field([0.75, 0.60, 0.80], description="highest corner, m")


class SimulatedEndConfig(Section):
    """A YuMi without sockets that follows with a first-order lag."""

    lag: float = Field(0.02, gt=0.0, description="time constant, s")
    posture: list[float] | None = Field(
        None, min_length=14, max_length=14, description="start, rad; none = the ready posture"
    )
