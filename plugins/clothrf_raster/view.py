"""The world-to-pixel map of a camera as the plain numbers that both engines use."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from clothrf_core.geometry import inverse
from clothrf_core.types import CameraModel, Float
from clothrf_raster.bend import Bend


@dataclass(frozen=True, slots=True, eq=False)
class View:
    """A camera, ready for drawing.

    Attributes:
        pose: (3, 4) float64 T_camera_world without its last row.
        lens: (5,) float64 fx, skew, cx, fy, cy; pixel (0, 0) is the centre of the first pixel.
        near: metres.
        far: metres.
        width: pixels.
        height: pixels.
        bend: what the lens does to the picture.
    """

    pose: Float
    lens: Float
    near: float
    far: float
    width: int
    height: int
    bend: Bend

    @classmethod
    def of(cls, camera: CameraModel, bend: Bend) -> View:
        """The view of `camera` through a lens that bends as told."""
        K = camera.K
        return cls(
            pose=np.ascontiguousarray(inverse(camera.T_world_camera)[:3]),
            lens=np.array([K[0, 0], K[0, 1], K[0, 2], K[1, 1], K[1, 2]]),
            near=camera.near,
            far=camera.far,
            width=camera.width,
            height=camera.height,
            bend=bend,
        )
