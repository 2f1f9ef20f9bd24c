"""What a config file can say about the MuJoCo cloth; the defaults suit every task."""

from __future__ import annotations

from pydantic import Field

from clothrf_core.rig import Section


class FlexOptions(Section):
    """How the cloth is stepped; what the cloth is comes with each `SimulationParams`."""

    substeps: int = Field(1, ge=1, le=32, description="implicit steps per call of `step`")
    stride: float = Field(
        0.02, gt=0.0, description="m; a corner that moves farther than this gets more substeps"
    )
    taut: float = Field(
        3.75,
        ge=1.0,
        description="stretch stiffness over the fabric's; flex has no strain limit at which the "
        "threads of a weave would be taut, so they are so from the start",
    )
    thickness: float = Field(
        0.001,
        gt=0.0,
        description="m; distance at which two layers of cloth touch, with `self_collision`",
    )
