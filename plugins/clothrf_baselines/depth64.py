"""A 64 x 64 depth picture as features: what nearest neighbours and the small net look at."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray
from typing_extensions import override

from clothrf_baselines.config import DepthConfig
from clothrf_core.camera_model import back_project
from clothrf_core.interfaces import FeatureExtractor
from clothrf_core.rig import ForegroundSection, Rig
from clothrf_core.types import CameraModel, Features, Float, Float32, Observation

SIDE = 64
PIXEL_PREFIX = "depth64_r"
GRASP_PREFIX = "depth64_grasp"

_ANYWHERE = ForegroundSection(
    depth_min=0.0, depth_max=10.0, low=[-100.0] * 3, high=[100.0] * 3, hue=None
)


class Depth64(FeatureExtractor):
    """Mean depth in metres of each of 64 x 64 cells of the whole picture; 0 where no cloth is.

    Cloth is what lies in the rig's depth range, workspace box and hue (the last two judged cell by
    cell). The anchor is the mean pixel of the cloth, back-projected at its mean depth. Names are
    ``depth64_rYY_cXX`` and, with `grasp`, ``depth64_graspI_x`` for the grippers' coordinates.
    """

    def __init__(self, config: DepthConfig, rig: Rig | None = None) -> None:
        self.config = config
        self._where = rig.foreground if rig is not None else _ANYWHERE
        names = [f"{PIXEL_PREFIX}{r:02d}_c{c:02d}" for r in range(SIDE) for c in range(SIDE)]
        if config.grasp:
            names += [f"{GRASP_PREFIX}{i}_{axis}" for i in range(2) for axis in "xyz"]
        self._names = tuple(names)

    @property
    @override
    def names(self) -> tuple[str, ...]:
        return self._names

    @override
    def extract(self, observation: Observation) -> Features:
        frame, where = observation.frame, self._where
        camera = frame.camera
        depth = frame.depth
        with np.errstate(invalid="ignore"):
            measured = (depth > where.depth_min) & (depth < where.depth_max)
        count = cells(measured.astype(np.float32))
        total = cells(np.where(measured, depth, np.float32(0.0)))
        mean = np.divide(total, count, out=np.zeros_like(total), where=count > 0)
        inside = (count > 0) & self._inside(camera, mean)
        if where.hue is not None:
            inside &= hue_cells(frame.rgb, where)
        number = float(count[inside].sum())
        if number < self.config.min_pixels:
            return self._nothing()
        picture = np.where(inside, mean, np.float32(0.0))
        anchor = self._anchor(camera, inside * count, picture)
        values = picture.ravel()
        if self.config.grasp:
            held = observation.grasp.positions.ravel().astype(np.float32)
            if len(held) != 6 or not np.isfinite(held).all():
                return self._nothing()
            values = np.concatenate([values, held])
        return Features(values=values.astype(np.float32), names=self._names, anchor=anchor)

    def _inside(self, camera: CameraModel, depth: Float32) -> NDArray[np.bool_]:
        """(64, 64) bool: cells whose middle, at their mean depth, lies in the workspace box."""
        points = back_project(camera, _middles(camera), depth.ravel().astype(np.float64))
        low, high = np.array(self._where.low), np.array(self._where.high)
        result: NDArray[np.bool_] = (
            ((points >= low) & (points <= high)).all(axis=1).reshape(SIDE, SIDE)
        )
        return result

    def _anchor(self, camera: CameraModel, weight: Float32, picture: Float32) -> Float:
        weights = weight.ravel().astype(np.float64)
        weights /= weights.sum()
        pixel = weights @ _middles(camera)
        anchor: Float = back_project(camera, pixel[None], np.array([weights @ picture.ravel()]))[0]
        return anchor

    def _nothing(self) -> Features:
        return Features(
            values=np.zeros(len(self._names), np.float32),
            names=self._names,
            anchor=np.zeros(3),
            valid=False,
        )


def cells(picture: Float32) -> Float32:
    """(64, 64) float32 sums of an (H, W) picture over cells of (nearly) equal size."""
    rows, columns = _borders(picture.shape[0]), _borders(picture.shape[1])
    summed = np.add.reduceat(picture, rows, axis=0)
    result: Float32 = np.add.reduceat(summed, columns, axis=1)
    return result


def hue_cells(rgb: NDArray[np.uint8], where: ForegroundSection) -> NDArray[np.bool_]:
    """(64, 64) bool: cells whose mean colour has the rig's hue, saturation and value."""
    assert where.hue is not None
    share = cells(np.ones(rgb.shape[:2], np.float32))
    r, g, b = (cells(rgb[:, :, i].astype(np.float32)) / share / 255.0 for i in range(3))
    value = np.maximum(np.maximum(r, g), b)
    spread = value - np.minimum(np.minimum(r, g), b)
    safe = np.where(spread > 0.0, spread, 1.0)
    hue = np.select(
        [value == r, value == g],
        [((g - b) / safe) % 6.0, (b - r) / safe + 2.0],
        default=(r - g) / safe + 4.0,
    )
    hue = 60.0 * hue
    first, second = (h % 360.0 for h in where.hue)
    near = (hue >= first) & (hue <= second)
    if first > second:
        near = (hue >= first) | (hue <= second)
    saturation = np.divide(spread, value, out=np.zeros_like(value), where=value > 0)
    result: NDArray[np.bool_] = (
        near & (spread > 0) & (saturation >= where.saturation_min) & (value >= where.value_min)
    )
    return result


def _borders(pixels: int) -> NDArray[np.intp]:
    return (np.arange(SIDE) * pixels) // SIDE


def _middles(camera: CameraModel) -> Float:
    """(4096, 2) pixel coordinates of the cells' middles, row by row."""
    edges_x = np.append(_borders(camera.width), camera.width)
    edges_y = np.append(_borders(camera.height), camera.height)
    x = 0.5 * (edges_x[:-1] + edges_x[1:] - 1)
    y = 0.5 * (edges_y[:-1] + edges_y[1:] - 1)
    grid_x, grid_y = np.meshgrid(x, y)
    return np.stack([grid_x.ravel(), grid_y.ravel()], axis=1)
