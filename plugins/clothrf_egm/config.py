"""Config section of the EGM end of the bridge."""

from __future__ import annotations

from pydantic import Field

from clothrf_core.rig import Section


class EgmConfig(Section):
    """Two UDP sessions, one an arm; the controller speaks first."""

    host: str = Field("127.0.0.1", description="address to listen on")
    left_port: int = Field(6511, ge=0, le=65535, description="UDP port of ROB_L; 0 = any free")
    right_port: int = Field(6512, ge=0, le=65535, description="UDP port of ROB_R; 0 = any free")
    controller: str | None = Field(
        None, description="the only address that is answered; none = the first that speaks"
    )
    timeout: float = Field(
        0.1, gt=0.0, description="without a request for this long a session has ended, s"
    )
    silence: float = Field(
        0.1, gt=0.0, description="without a posture for this long the last one is held, s"
    )
    start_tolerance: float = Field(
        0.035, gt=0.0, description="the first posture must be this close to the measured one, rad"
    )
    speed_reference: bool = Field(
        False, description="send joint speeds as feed-forward beside the positions"
    )
