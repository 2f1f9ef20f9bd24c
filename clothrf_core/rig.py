"""A rig: where camera, table, person and robot stand. One TOML file a real or imagined set-up.

Numbers are in the world frame (the robot's base): metres, x forward, z up.
"""

from __future__ import annotations

from typing import Annotated, Literal

import numpy as np
from pydantic import BaseModel, ConfigDict, Field

from clothrf_core.types import CameraModel, Float

Vector = Annotated[list[float], Field(min_length=3, max_length=3)]


class Section(BaseModel):
    """Base of every config section: no unknown keys, nothing changes after reading."""

    model_config = ConfigDict(extra="forbid", frozen=True)


class CameraSection(Section):
    """The camera's numbers, as a `*.camera.toml` holds them."""

    width: int = Field(640, ge=1)
    height: int = Field(480, ge=1)
    K: list[list[float]] = Field(description="3 x 3 intrinsics; (0, 0) = centre of first pixel")
    distortion: list[float] = Field([], description="OpenCV order; 0, 4, 5 or 8 numbers")
    T_world_camera: list[list[float]] = Field(description="4 x 4 pose, OpenCV axes, metres")
    near: float = Field(0.1, gt=0.0, description="near clip of the rendered camera, m")
    far: float = Field(2.0, gt=0.0, description="far clip of the rendered camera, m")
    depth_unit: float = Field(0.001, gt=0.0, description="metres a count of the depth picture")
    provenance: str = ""

    def model(self) -> CameraModel:
        """The `CameraModel` of these numbers."""
        return CameraModel(
            width=self.width,
            height=self.height,
            K=np.array(self.K, float),
            T_world_camera=np.array(self.T_world_camera, float),
            near=self.near,
            far=self.far,
            distortion=np.array(self.distortion, float),
            provenance=self.provenance,
        )


class HandsSection(Section):
    """Where the person's hands may be."""

    rest: list[Vector] = Field(min_length=2, max_length=2, description="2 x 3 rest corners, m")
    range: Vector = Field([0.1, 0.1, 0.1], description="half-width of the targets per axis, m")
    max_distance: float = Field(0.30, gt=0.0, description="|v2 - v3|, m")
    max_speed: float = Field(0.10, gt=0.0, description="per axis, m/s")


class GraspSection(Section):
    """Where the robot's grippers start and may go."""

    rest: list[Vector] = Field(min_length=2, max_length=2, description="2 x 3 rest corners, m")


class TableSection(Section):
    """The table under the cloth."""

    low: Vector = Field([0.0, -0.6, -0.04], description="box corner, m")
    high: Vector = Field([1.0, 0.6, -0.02], description="opposite box corner, m")
    colour: Vector = Field([0.45, 0.44, 0.42], description="linear RGB")
    measurable: bool = Field(True, description="False: bare metal, gives no depth")


class ForegroundSection(Section):
    """What tells cloth from everything else in a picture of this rig."""

    depth_min: float = Field(0.2, ge=0.0, description="m along the optical axis")
    depth_max: float = Field(0.9, gt=0.0, description="m along the optical axis")
    low: Vector = Field(description="workspace box, world, m")
    high: Vector = Field(description="opposite corner of the workspace box, world, m")
    hue: list[float] | None = Field(
        None,
        min_length=2,
        max_length=2,
        description="hue range of the cloth in degrees; wraps if first > second; none = no cue",
    )
    saturation_min: float = Field(0.15, ge=0.0, le=1.0, description="with hue only")
    value_min: float = Field(0.05, ge=0.0, le=1.0, description="with hue only")


class Rig(Section):
    """All of it."""

    name: str = "rig"
    kind: Literal["rig"] = "rig"
    camera: CameraSection
    hands: HandsSection
    grasp: GraspSection
    table: TableSection = TableSection()
    foreground: ForegroundSection

    @property
    def rest_hands(self) -> Float:
        """(2, 3) float64, world."""
        return np.array(self.hands.rest, float)

    @property
    def rest_grasp(self) -> Float:
        """(2, 3) float64, world."""
        return np.array(self.grasp.rest, float)
