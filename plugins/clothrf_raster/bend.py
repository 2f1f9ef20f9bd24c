"""Drawing through a lens without a detour: how finely triangles must be cut, and where.

A straight edge is bent by the lens, so triangles are cut until no edge is longer than `piece`
pixels; then the straight chord is off by at most 0.04 pixels, and corners are put where
the lens equation puts them. Cutting depends on an edge alone, so neighbours agree and no crack
opens. Where a lens folds the picture over itself just outside the frame this is not safe, and the
caller resamples a pinhole picture instead (`clothrf_core.lens`).
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from clothrf_core.camera_model import distort, normalised, undistort
from clothrf_core.lens import lens_key
from clothrf_core.types import CameraModel, Float

CHORD = 0.04
SHORTEST, LONGEST = 4.0, 64.0
# Pixels around the frame in which pieces that reach into it may end.
MARGIN = 64.0
GRID = 24


@dataclass(frozen=True, slots=True, eq=False)
class Bend:
    """How a lens bends the picture.

    Attributes:
        coefficients: (8,) float64, OpenCV's order, zeros where not given.
        piece: longest edge of a piece, pixels of the pinhole picture; 0 = no distortion.
        window: (4,) float64 left, top, right, bottom: all that can be seen, in those pixels.
    """

    coefficients: Float
    piece: float
    window: Float

    @classmethod
    def none(cls) -> Bend:
        """No distortion."""
        return cls(np.zeros(8), 0.0, np.zeros(4))

    @classmethod
    def of(cls, camera: CameraModel) -> Bend | None:
        """The bend of a camera; None if it cannot be drawn directly."""
        k = camera.distortion
        if not k.any():
            return cls.none()
        low, high = _window(camera)
        if not (np.isfinite(low).all() and np.isfinite(high).all()):
            return None
        margin = MARGIN / np.array([camera.K[0, 0], camera.K[1, 1]])
        step = (high - low + 2 * margin) / GRID
        x = low[0] - margin[0] + step[0] * np.arange(GRID + 1)
        y = low[1] - margin[1] + step[1] * np.arange(GRID + 1)
        grid = np.stack(np.meshgrid(x, y), axis=-1)
        bent = distort(k, grid.reshape(-1, 2)).reshape(grid.shape)
        if not _keeps_its_side(bent):
            return None
        scale = np.array([camera.K[0, 0], camera.K[1, 1]])
        curvature = 0.0
        for axis in (0, 1):
            second = np.diff(bent, n=2, axis=axis) * scale
            width = step[1 - axis] * scale[1 - axis]
            curvature = max(curvature, float(np.linalg.norm(second, axis=-1).max()) / width**2)
        piece = float(np.clip(np.sqrt(8.0 * CHORD / max(curvature, 1e-9)), SHORTEST, LONGEST))
        corners = np.stack([low, high])
        pixels = corners * scale + np.array([camera.K[0, 2], camera.K[1, 2]])
        pixels[:, 0] += camera.K[0, 1] * corners[:, 1]
        skew = abs(camera.K[0, 1]) * float(high[1] - low[1])
        window = np.array(
            [pixels[0, 0] - skew - 2, pixels[0, 1] - 2, pixels[1, 0] + skew + 2, pixels[1, 1] + 2]
        )
        return cls(np.concatenate([k, np.zeros(8 - k.size)]), piece, window)


class BendCache:
    """The bend used last; a camera that moves keeps it."""

    def __init__(self) -> None:
        self._key: tuple[object, ...] = ()
        self._last: Bend | None = None

    def of(self, camera: CameraModel) -> Bend | None:
        """As `Bend.of`, from the cache if only the pose or the clip range changed."""
        key = lens_key(camera)
        if key != self._key:
            self._last = Bend.of(camera)
            self._key = key
        return self._last


def _window(camera: CameraModel) -> tuple[Float, Float]:
    """Least and greatest undistorted (x/z, y/z) of the rays through the frame's rim."""
    w, h = camera.width, camera.height
    u, v = np.arange(w, dtype=float), np.arange(h, dtype=float)
    rim = np.concatenate(
        [
            np.stack([u, np.zeros(w)], 1),
            np.stack([u, np.full(w, h - 1.0)], 1),
            np.stack([np.zeros(h), v], 1),
            np.stack([np.full(h, w - 1.0), v], 1),
        ]
    )
    bent = normalised(camera.K, rim)
    with np.errstate(all="ignore"):
        straight = undistort(camera.distortion, bent)
        error = np.abs(distort(camera.distortion, straight) - bent).max()
    if not error * camera.K[0, 0] < 0.01:
        return np.full(2, np.nan), np.full(2, np.nan)
    return straight.min(axis=0), straight.max(axis=0)


def _keeps_its_side(bent: Float) -> bool:
    """Whether the lens maps the grid one to one: every cell keeps its orientation."""
    right = np.diff(bent, axis=1)[:-1]
    down = np.diff(bent, axis=0)[:, :-1]
    area = right[..., 0] * down[..., 1] - right[..., 1] * down[..., 0]
    return bool((area > 0.0).all())
