"""Projection and its inverse for `CameraModel`: OpenCV's pinhole with distortion, in numpy.

Distortion coefficients in OpenCV's order: k1 k2 p1 p2 [k3 [k4 k5 k6]] (Brown 1966; rational
model as in OpenCV's documentation of ``calibrateCamera``).
"""

from __future__ import annotations

import dataclasses

import numpy as np

from clothrf_core.geometry import apply, inverse
from clothrf_core.types import CameraModel, Float, Float32


def project(camera: CameraModel, points: Float) -> tuple[Float, Float]:
    """Pixels (N, 2) and depths (N,) of (N, 3) world points; pixels are NaN behind the camera."""
    local = apply(inverse(camera.T_world_camera), np.asarray(points, float))
    z = local[:, 2]
    with np.errstate(divide="ignore", invalid="ignore"):
        xy = np.where(z[:, None] > 0.0, local[:, :2] / z[:, None], np.nan)
    xy = distort(camera.distortion, xy)
    K = camera.K
    u = K[0, 0] * xy[:, 0] + K[0, 1] * xy[:, 1] + K[0, 2]
    v = K[1, 1] * xy[:, 1] + K[1, 2]
    return np.stack([u, v], axis=1), z


def back_project(camera: CameraModel, pixels: Float, depth: Float) -> Float:
    """(N, 3) world points at (N, 2) pixels and (N,) depths along the optical axis."""
    xy = undistort(camera.distortion, normalised(camera.K, np.asarray(pixels, float)))
    z = np.asarray(depth, float)[:, None]
    return apply(camera.T_world_camera, np.concatenate([xy * z, z], axis=1))


def normalised(K: Float, pixels: Float) -> Float:
    """(N, 2) image-plane coordinates at depth 1, still distorted, of (N, 2) pixels."""
    y = (pixels[:, 1] - K[1, 2]) / K[1, 1]
    x = (pixels[:, 0] - K[0, 2] - K[0, 1] * y) / K[0, 0]
    return np.stack([x, y], axis=1)


def distort(k: Float, xy: Float) -> Float:
    """(N, 2) normalised coordinates as the lens bends them."""
    if k.size == 0:
        return xy
    c = np.concatenate([k, np.zeros(8 - k.size)])
    x, y = xy[:, 0], xy[:, 1]
    r2 = x * x + y * y
    radial = (1 + r2 * (c[0] + r2 * (c[1] + r2 * c[4]))) / (
        1 + r2 * (c[5] + r2 * (c[6] + r2 * c[7]))
    )
    dx = 2 * c[2] * x * y + c[3] * (r2 + 2 * x * x)
    dy = c[2] * (r2 + 2 * y * y) + 2 * c[3] * x * y
    return np.stack([x * radial + dx, y * radial + dy], axis=1)


def undistort(k: Float, xy: Float, *, iterations: int = 40) -> Float:
    """Inverse of `distort` by fixed-point iteration (OpenCV's way, to 1e-13)."""
    if k.size == 0:
        return xy
    guess = np.array(xy, float)
    for _ in range(iterations):
        change = xy - distort(k, guess)
        guess += change
        if float(np.nanmax(np.abs(change), initial=0.0)) < 1e-13:
            break
    return guess


def cropped(camera: CameraModel, x0: int, y0: int, width: int, height: int) -> CameraModel:
    """The camera of the sub-picture whose top-left pixel is (x0, y0)."""
    K = np.array(camera.K)
    K[0, 2] -= x0
    K[1, 2] -= y0
    return dataclasses.replace(camera, width=width, height=height, K=K)


def scaled(camera: CameraModel, factor: float) -> CameraModel:
    """The camera of the picture resized by `factor` about its outer border.

    With pixel centres at integers the principal point follows cx' = (cx + 0.5) s - 0.5.
    """
    K = np.array(camera.K)
    K[:2] *= factor
    K[0, 2] += 0.5 * factor - 0.5
    K[1, 2] += 0.5 * factor - 0.5
    return dataclasses.replace(
        camera, width=round(camera.width * factor), height=round(camera.height * factor), K=K
    )


def clip_range(camera: CameraModel, low: Float, high: Float) -> tuple[float, float]:
    """Near and far planes that hold the world box `low` (3,) to `high` (3,) with a margin."""
    corners = np.array(
        [[x, y, z] for x in (low[0], high[0]) for y in (low[1], high[1]) for z in (low[2], high[2])]
    )
    z = apply(inverse(camera.T_world_camera), corners)[:, 2]
    near = max(0.05, 0.8 * float(z.min()))
    return near, max(near + 0.1, 1.2 * float(z.max()) + 0.05)


def rays(camera: CameraModel) -> Float32:
    """(H, W, 2) float32: x/z and y/z of every pixel's ray, distortion removed."""
    u, v = np.meshgrid(np.arange(camera.width, dtype=float), np.arange(camera.height, dtype=float))
    pixels = np.stack([u.ravel(), v.ravel()], axis=1)
    xy = undistort(camera.distortion, normalised(camera.K, pixels))
    return xy.reshape(camera.height, camera.width, 2).astype(np.float32)
