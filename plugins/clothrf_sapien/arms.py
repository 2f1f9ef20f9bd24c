"""Robot arms as something to draw: one mesh of all the capsules that a collision model gives."""

from __future__ import annotations

import numpy as np

from clothrf_core.errors import ShapeError
from clothrf_core.scene import Label, SceneMesh, capsule
from clothrf_core.types import Float

ARM_GREY = (0.62, 0.62, 0.60)


def arm_mesh(
    starts: Float,
    ends: Float,
    radii: Float,
    *,
    colour: tuple[float, float, float] = ARM_GREY,
    measurable: bool = True,
    segments: int = 6,
) -> SceneMesh:
    """All links as one mesh labelled GRIPPER.

    Args:
        starts: (N, 3) one end of each capsule's axis, metres, world.
        ends: (N, 3) the other end.
        radii: (N,) metres.
        colour: linear RGB.
        measurable: False for arms on which the depth camera reads nothing.
        segments: half the number of faces around a capsule, even.

    Raises:
        ShapeError: the three do not fit together.
    """
    if not (starts.shape == ends.shape == (len(radii), 3)):
        raise ShapeError(
            f"arm_mesh: expected starts and ends of shape ({len(radii)}, 3) for {len(radii)} "
            f"radii, got {starts.shape} and {ends.shape}"
        )
    vertices, triangles, count = [np.zeros((0, 3))], [np.zeros((0, 3), np.int32)], 0
    for start, end, radius in zip(starts, ends, radii, strict=True):
        link = capsule(start, end, float(radius), Label.GRIPPER, colour, segments=segments)
        vertices.append(link.vertices)
        triangles.append(link.triangles + np.int32(count))
        count += len(link.vertices)
    return SceneMesh(
        label=Label.GRIPPER,
        vertices=np.concatenate(vertices),
        triangles=np.concatenate(triangles),
        colour=colour,
        measurable=measurable,
    )
