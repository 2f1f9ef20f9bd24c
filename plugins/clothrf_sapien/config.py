"""What a config file can say about the SAPIEN backend's cloth; the defaults suit every task."""

from __future__ import annotations

from pydantic import Field

from clothrf_core.rig import Section


class ClothOptions(Section):
    """How the cloth is stepped; what the cloth is comes with each `SimulationParams`."""

    substeps: int = Field(1, ge=1, le=32, description="implicit Euler steps per call of `step`")
    iterations: int = Field(20, ge=1, le=200, description="most Newton iterations a substep")
    tolerance: float = Field(
        1.0e-3, gt=0.0, description="m; Newton stops when its longest move is shorter"
    )
    strain_limit: float = Field(
        0.005, ge=0.0, description="edge strain beyond which the threads of the weave are taut"
    )
    taut: float = Field(
        5.0, ge=0.0, description="extra stiffness beyond the strain limit, times the stretch's"
    )
    thickness: float = Field(
        5.0e-3, gt=0.0, description="m; layers are kept this far apart with self-collision"
    )
