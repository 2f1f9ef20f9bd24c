"""The pinhole camera with OpenCV distortion, and its derivatives.

Intrinsic parameters are one vector ``[fx, fy, cx, cy, k1, k2, p1, p2, k3, k4, k5, k6]`` cut to the
model's length; models have 0, 4, 5 or 8 distortion coefficients (Brown 1966, rational model as in
OpenCV's documentation of ``calibrateCamera``).
"""

from __future__ import annotations

import numpy as np

from clothrf_core.types import Float

MODELS = (0, 4, 5, 8)


def matrix(parameters: Float) -> Float:
    """(3, 3) K of an intrinsic vector."""
    fx, fy, cx, cy = parameters[:4]
    return np.array([[fx, 0.0, cx], [0.0, fy, cy], [0.0, 0.0, 1.0]])


def vector(K: Float, distortion: Float) -> Float:
    """Intrinsic vector of a (3, 3) K and distortion coefficients."""
    return np.concatenate([[K[0, 0], K[1, 1], K[0, 2], K[1, 2]], distortion])


def project(parameters: Float, points: Float) -> Float:
    """(N, 2) pixels of (N, 3) points in the camera frame."""
    return project_jacobian(parameters, points)[0]


def project_jacobian(parameters: Float, points: Float) -> tuple[Float, Float, Float]:
    """Pixels and their derivatives.

    Args:
        parameters: (4 + D,) intrinsic vector.
        points: (N, 3) metres in the camera frame.

    Returns:
        (N, 2) pixels, (N, 2, 3) derivatives by the point, (N, 2, 4 + D) by the parameters.
    """
    fx, fy, cx, cy = parameters[:4]
    d = parameters.size - 4
    k = np.zeros(8)
    k[:d] = parameters[4:]
    iz = 1.0 / points[:, 2]
    x, y = points[:, 0] * iz, points[:, 1] * iz
    r2 = x * x + y * y
    r4, r6 = r2 * r2, r2 * r2 * r2
    top = 1 + k[0] * r2 + k[1] * r4 + k[4] * r6
    low = 1 + k[5] * r2 + k[6] * r4 + k[7] * r6
    g = top / low
    xd = x * g + 2 * k[2] * x * y + k[3] * (r2 + 2 * x * x)
    yd = y * g + k[2] * (r2 + 2 * y * y) + 2 * k[3] * x * y
    pixels = np.stack([fx * xd + cx, fy * yd + cy], axis=1)
    dg = (
        (k[0] + 2 * k[1] * r2 + 3 * k[4] * r4) - g * (k[5] + 2 * k[6] * r2 + 3 * k[7] * r4)
    ) / low  # by r2
    dxx = g + 2 * x * x * dg + 2 * k[2] * y + 6 * k[3] * x
    dxy = 2 * x * y * dg + 2 * k[2] * x + 2 * k[3] * y
    dyy = g + 2 * y * y * dg + 6 * k[2] * y + 2 * k[3] * x
    by_point = np.empty((len(x), 2, 3))
    by_point[:, 0, 0], by_point[:, 0, 1] = fx * dxx * iz, fx * dxy * iz
    by_point[:, 1, 0], by_point[:, 1, 1] = fy * dxy * iz, fy * dyy * iz
    by_point[:, :, 2] = -(by_point[:, :, 0] * x[:, None] + by_point[:, :, 1] * y[:, None])
    by_parameter = np.zeros((len(x), 2, 4 + d))
    by_parameter[:, 0, 0], by_parameter[:, 1, 1] = xd, yd
    by_parameter[:, 0, 2] = by_parameter[:, 1, 3] = 1.0
    if d:
        inverse = 1.0 / low
        radial = [r2 * inverse, r4 * inverse, r6 * inverse]
        radial += [-g * r2 * inverse, -g * r4 * inverse, -g * r6 * inverse]
        columns = {
            4: (x * radial[0], y * radial[0]),
            5: (x * radial[1], y * radial[1]),
            6: (2 * x * y, r2 + 2 * y * y),
            7: (r2 + 2 * x * x, 2 * x * y),
            8: (x * radial[2], y * radial[2]),
            9: (x * radial[3], y * radial[3]),
            10: (x * radial[4], y * radial[4]),
            11: (x * radial[5], y * radial[5]),
        }
        for column in range(4, 4 + d):
            by_parameter[:, 0, column] = fx * columns[column][0]
            by_parameter[:, 1, column] = fy * columns[column][1]
    return pixels, by_point, by_parameter


def directions(parameters: Float, pixels: Float) -> Float:
    """(N, 2) undistorted x/z, y/z of (N, 2) pixels, by Gauss-Newton steps."""
    K, k = matrix(parameters), parameters
    start = (pixels - K[:2, 2]) / np.array([K[0, 0], K[1, 1]])
    xy = np.array(start)
    for _ in range(30):
        points = np.concatenate([xy, np.ones((len(xy), 1))], axis=1)
        seen, by_point, _ = project_jacobian(k, points)
        step = np.linalg.solve(by_point[:, :, :2], (pixels - seen)[:, :, None])[:, :, 0]
        size = np.linalg.norm(step, axis=1, keepdims=True)
        xy += step * np.minimum(1.0, 0.3 / np.maximum(size, 1e-12))
        if float(np.abs(step).max(initial=0.0)) < 1e-12:
            break
    return xy
