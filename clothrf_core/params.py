"""What may vary from one roll-out to the next: the cloth, the camera, the light, the sensor.

A `Randomization` is drawn once a roll-out. With all strengths at zero it equals the nominal one,
which comes from the config and the rig.
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, field
from typing import Any

import numpy as np

from clothrf_core.arrays import checked
from clothrf_core.scene import Light, Pattern, SceneMesh
from clothrf_core.types import CameraModel, Float, _set, frozen_mapping


@dataclass(frozen=True, slots=True)
class Fabric:
    """Areal material parameters of a woven or knitted sheet.

    Attributes:
        name: what it is called in reports.
        density: areal density, kg/m^2.
        stretch_warp: membrane stiffness along v (hand to grasp), N/m.
        stretch_weft: membrane stiffness along u (hand to hand), N/m.
        shear: shear stiffness, N/m.
        bending: bending stiffness, N m.
        damping: stiffness-proportional damping time, s.
        drag: velocity-proportional drag of the air, 1/s.
    """

    name: str = "camel-ponte-roma"
    density: float = 0.284
    stretch_warp: float = 400.0
    stretch_weft: float = 400.0
    shear: float = 60.0
    bending: float = 2.0e-5
    damping: float = 2.0e-3
    drag: float = 1.0


@dataclass(frozen=True, slots=True, eq=False)
class SimulationParams:
    """What a `Simulator.reset` starts from.

    Attributes:
        size: cloth size in metres, (u between the hands, v from hand to grasp).
        resolution: vertices along u and along v.
        fabric: the material.
        hands: (2, 3) float64 where the person holds it at the start, world.
        grasp: (2, 3) float64 where the robot holds it at the start, world.
        self_collision: keep layers of cloth apart.
        settle_s: simulated seconds run before the first state is returned.
    """

    hands: Float
    grasp: Float
    size: tuple[float, float] = (0.30, 0.35)
    resolution: tuple[int, int] = (21, 24)
    fabric: Fabric = field(default_factory=Fabric)
    self_collision: bool = False
    settle_s: float = 0.5

    def __post_init__(self) -> None:
        _set(
            self,
            hands=checked("SimulationParams.hands", self.hands, (2, 3), np.float64, finite=True),
            grasp=checked("SimulationParams.grasp", self.grasp, (2, 3), np.float64, finite=True),
        )


@dataclass(frozen=True, slots=True)
class HandNoise:
    """Ornstein-Uhlenbeck disturbance of the person's hands.

    Attributes:
        std: stationary standard deviation per axis, metres; 0 = none.
        time_constant_s: correlation time.
    """

    std: float = 0.0
    time_constant_s: float = 0.3


@dataclass(frozen=True, slots=True, eq=False)
class Randomization:
    """Everything drawn for one roll-out.

    Attributes:
        simulation: cloth, fabric, start.
        camera: the camera that renders; what the policy is told stays the rig's nominal camera.
        light: the light.
        cloth_colour: linear RGB.
        cloth_pattern: printed on the cloth; None = plain.
        table_pattern: printed on the table; None = plain.
        backdrop: what stands behind everything; None = the plain background of a `Scene`.
        hand_noise: disturbance of the person's hands.
        occluders: meshes between camera and cloth, still during the roll-out.
        sensor: numbers that only the randomiser that drew them understands (noise strengths).
    """

    simulation: SimulationParams
    camera: CameraModel
    light: Light = field(default_factory=Light)
    cloth_colour: tuple[float, float, float] = (0.10, 0.45, 0.50)
    cloth_pattern: Pattern | None = None
    table_pattern: Pattern | None = None
    backdrop: SceneMesh | None = None
    hand_noise: HandNoise = field(default_factory=HandNoise)
    occluders: tuple[SceneMesh, ...] = ()
    sensor: Mapping[str, Any] = field(default_factory=frozen_mapping)
