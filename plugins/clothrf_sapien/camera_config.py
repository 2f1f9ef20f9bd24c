"""What can be set about the SAPIEN renderer."""

from __future__ import annotations

from pydantic import Field

from clothrf_core.rig import Section


class SapienCameraConfig(Section):
    """Options of ``[camera] plugin = "sapien"``; the camera itself comes from the rig."""

    shadows: bool = Field(
        False, description="let surfaces cast shadows on each other and on themselves"
    )
    shadow_map_size: int = Field(
        1024, ge=64, le=8192, description="texels along one side of the shadow map"
    )
    device: str = Field(
        "",
        description="Vulkan device as SAPIEN names it, for example 'cuda:0'; empty = its choice: "
        "a GPU where there is one, else the CPU (lavapipe)",
    )
