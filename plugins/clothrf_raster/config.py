"""What can be set about the CPU renderer."""

from __future__ import annotations

from typing import Literal

from pydantic import Field

from clothrf_core.rig import Section


class RasterConfig(Section):
    """Options of ``plugin = "raster"``; the camera itself comes from the rig."""

    colour: bool = Field(
        True,
        description="shade a colour picture; False leaves `rgb` black and takes half the time, "
        "which is enough wherever only depth and labels are used",
    )
    engine: Literal["auto", "numba", "numpy"] = Field(
        "auto",
        description="numba: compiled, under 1 ms a 640 x 480 frame without colour; numpy: the "
        "same picture, bit for bit, about 30 times slower; auto: numba where it is installed",
    )
