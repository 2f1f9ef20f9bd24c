"""Config section of the EGM end of the bridge."""

from __future__ import annotations

import ipaddress
from typing import Self

from pydantic import Field, model_validator

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

    @model_validator(mode="after")
    def _name_the_controller(self) -> Self:
        # EGM knows no passwords: beyond this machine the sender's address is all there is.
        for name, value in (("host", self.host), ("controller", self.controller)):
            if value is not None and not _is_address(value):
                raise ValueError(f"{name}: expected an IPv4 address, found '{value}'")
        if self.controller is None and not ipaddress.ip_address(self.host).is_loopback:
            raise ValueError(
                f"controller: expected the controller's address beside host '{self.host}', which "
                "others reach too; found none"
            )
        return self


def _is_address(text: str) -> bool:
    try:
        ipaddress.IPv4Address(text)
    except ValueError:
        return False
    return True
