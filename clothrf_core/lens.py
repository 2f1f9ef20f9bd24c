"""Lens distortion for renderers that can only draw a pinhole picture.

Draw the pinhole picture of the same focal length, just large enough for every ray of the real
lens, then resample it: colour bilinearly, labels from the nearest pixel, depth bilinearly in
*inverse* depth (which is linear on a plane) and from the nearest pixel at edges and holes.
"""

from __future__ import annotations

import dataclasses
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from clothrf_core.camera_model import distort, normalised, undistort
from clothrf_core.errors import ShapeError
from clothrf_core.scene import Picture
from clothrf_core.types import CameraModel, Float, Float32, RgbdFrame

# Relative steps of inverse depth between neighbouring pixels that still are one surface: small
# ones, and larger ones that go on as they began (a plane seen at a grazing angle is linear).
SMALL, STEADY = 0.002, 0.001
LARGEST = 3.0


@dataclass(frozen=True, slots=True, eq=False)
class Lens:
    """How to make the pictures of a camera with distortion from pinhole pictures.

    Attributes:
        key: what the lens depends on, see `lens_key`; not the pose.
        shape: (H, W) of the real picture.
        K: (3, 3) of the pinhole picture: same focal length, principal point moved.
        size: (width, height) of the pinhole picture.
        corner: (H * W,) int32 flat index of the pinhole pixel up left of each real pixel.
        nearest: (H * W,) int32 flat index of the closest pinhole pixel.
        weight: (2, H * W) float32 fractions right and down of `corner`.
    """

    key: tuple[object, ...]
    shape: tuple[int, int]
    K: Float
    size: tuple[int, int]
    corner: NDArray[np.int32]
    nearest: NDArray[np.int32]
    weight: Float32

    @classmethod
    def of(cls, camera: CameraModel) -> Lens:
        """The lens of a camera with distortion.

        Raises:
            ShapeError: the distortion cannot be undone inside the picture, or needs a pinhole
                picture more than three times as wide or high.
        """
        pixels = _pinhole_pixels(camera)
        low = np.floor(pixels.min(axis=0)) - 1.0
        width, height = (int(n) for n in np.ceil(pixels.max(axis=0)) + 2.0 - low)
        if max(width / camera.width, height / camera.height) > LARGEST:
            raise ShapeError(
                f"CameraModel.distortion: expected a lens whose pinhole picture is at most "
                f"{LARGEST:g} times as large, got {width} x {height} for {camera.width} x "
                f"{camera.height}; check the coefficients {camera.distortion.tolist()}"
            )
        K = np.array(camera.K)
        K[:2, 2] -= low
        place = (pixels - low).astype(np.float32)
        whole = np.floor(place).astype(np.int32)
        near = np.rint(place).astype(np.int32)
        return cls(
            key=lens_key(camera),
            shape=(camera.height, camera.width),
            K=K,
            size=(width, height),
            corner=whole[:, 1] * width + whole[:, 0],
            nearest=near[:, 1] * width + near[:, 0],
            weight=np.ascontiguousarray((place - np.floor(place)).T),
        )

    def pinhole(self, camera: CameraModel) -> CameraModel:
        """The distortion-free camera to render instead of `camera`, at its pose."""
        return dataclasses.replace(
            camera, width=self.size[0], height=self.size[1], K=self.K, distortion=np.zeros(0)
        )

    def bend(self, picture: Picture, camera: CameraModel, *, colour: bool = True) -> Picture:
        """What `camera` sees, from the picture of its pinhole; `colour` off leaves rgb black."""
        frame = RgbdFrame(
            stamp_ns=picture.frame.stamp_ns,
            rgb=self._colour(picture.frame.rgb) if colour else np.zeros((*self.shape, 3), np.uint8),
            depth=self._depth(picture).reshape(self.shape),
            camera=camera,
        )
        labels = picture.labels.reshape(-1)[self.nearest].reshape(self.shape)
        return Picture(frame=frame, labels=labels)

    def _depth(self, picture: Picture) -> Float32:
        depth = picture.frame.depth
        inverse = (np.float32(1.0) / depth).reshape(-1)
        right, down = self.weight
        width = self.size[0]
        a, b = inverse[self.corner], inverse[self.corner + 1]
        c, d = inverse[self.corner + width], inverse[self.corner + width + 1]
        top = a + right * (b - a)
        bottom = c + right * (d - c)
        smooth = np.float32(1.0) / (top + down * (bottom - top))
        one_surface = _one_surface(1.0 / depth, picture.labels).reshape(-1)[self.corner]
        nearest = depth.reshape(-1)[self.nearest]
        return np.where(one_surface, smooth, nearest)

    def _colour(self, rgb: NDArray[np.uint8]) -> NDArray[np.uint8]:
        flat = rgb.reshape(-1, 3)
        right, down = self.weight[:, :, None]
        width = self.size[0]
        a, b = flat[self.corner].astype(np.float32), flat[self.corner + 1]
        c, d = flat[self.corner + width].astype(np.float32), flat[self.corner + width + 1]
        top = a + right * (b - a)
        bottom = c + right * (d - c)
        mixed = np.rint(top + down * (bottom - top)).astype(np.uint8)
        result: NDArray[np.uint8] = mixed.reshape(*self.shape, 3)
        return result


class LensCache:
    """The lens used last; a camera that moves keeps its lens."""

    def __init__(self) -> None:
        self._last: Lens | None = None

    def of(self, camera: CameraModel) -> Lens:
        """As `Lens.of`, from the cache if only the pose or the clip range changed."""
        if self._last is None or self._last.key != lens_key(camera):
            self._last = Lens.of(camera)
        return self._last


def lens_key(camera: CameraModel) -> tuple[object, ...]:
    """Equal for cameras with the same lens: size, K and distortion."""
    return (camera.width, camera.height, camera.K.tobytes(), camera.distortion.tobytes())


def _pinhole_pixels(camera: CameraModel) -> Float:
    """(H * W, 2) where each pixel of `camera` lies on an endless pinhole picture of the same K."""
    u, v = np.meshgrid(np.arange(camera.width, dtype=float), np.arange(camera.height, dtype=float))
    bent = normalised(camera.K, np.stack([u.ravel(), v.ravel()], axis=1))
    with np.errstate(all="ignore"):
        straight = undistort(camera.distortion, bent)
        error = np.abs(distort(camera.distortion, straight) - bent).max(axis=1)
    worst = float(np.max(np.where(np.isfinite(error), error, np.inf))) * float(camera.K[0, 0])
    if worst > 0.01:
        raise ShapeError(
            "CameraModel.distortion: expected coefficients that can be undone all over the "
            f"picture, got {camera.distortion.tolist()}, which leave {worst:.2g} pixels; calibrate "
            "with views that reach the corners, or with fewer coefficients"
        )
    K = camera.K
    x, y = straight.T
    return np.stack([K[0, 0] * x + K[0, 1] * y + K[0, 2], K[1, 1] * y + K[1, 2]], axis=1)


def _one_surface(inverse: Float32, labels: NDArray[np.uint8]) -> NDArray[np.bool_]:
    """(H, W) whether a pixel and its right, lower and lower right neighbours are one surface."""
    right = _continues(inverse, labels)
    down = _continues(inverse.T, labels.T).T
    result = np.zeros(inverse.shape, bool)
    result[:-1, :-1] = right[:-1] & right[1:] & down[:, :-1] & down[:, 1:]
    return result


def _continues(inverse: Float32, labels: NDArray[np.uint8]) -> NDArray[np.bool_]:
    """(H, W - 1) whether a pixel and its right neighbour are one surface."""
    step = np.diff(inverse, axis=1)
    small = np.abs(step) <= np.float32(SMALL) * inverse[:, 1:]
    change = np.abs(np.diff(step, axis=1)) <= np.float32(STEADY) * inverse[:, 1:-1]
    steady = np.zeros(step.shape, bool)
    steady[:, 1:] = change
    steady[:, :-1] |= change
    result: NDArray[np.bool_] = (small | steady) & (labels[:, 1:] == labels[:, :-1])
    return result
