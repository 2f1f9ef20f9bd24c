"""Moments of the cloth's points: where it lies, how far it spreads, how lopsided it is."""

from __future__ import annotations

import numpy as np
from numba import njit
from numpy.typing import NDArray

from clothrf_core.types import Float32
from clothrf_how.cloud import Cloud

AXES = "xyz"
PAIRS = ((0, 0), (1, 1), (2, 2), (0, 1), (0, 2), (1, 2))
TRIPLES = tuple((i, j, k) for i in range(3) for j in range(i, 3) for k in range(j, 3))


def moments_names() -> tuple[str, ...]:
    """3 means, 6 second and 10 third central moments, and the cloth's visible area."""
    return (
        *(f"moments_{a}" for a in AXES),
        *(f"moments_{AXES[i]}{AXES[j]}" for i, j in PAIRS),
        *(f"moments_{AXES[i]}{AXES[j]}{AXES[k]}" for i, j, k in TRIPLES),
        "moments_area",
    )


def moments(cloud: Cloud) -> Float32:
    """(20,) float32.

    Means in metres; the n-th moments' n-th root with sign, so that all are metres and a linear
    model can use them; the area is the root of the pixel count times the squared distance, metres
    times pixels / 100.
    """
    count, first, second, third = raw_moments(cloud.points, cloud.mask)
    mean = first / count
    values = list(mean)
    covariance = second / count - np.outer(mean, mean)
    values += [np.sign(covariance[p]) * np.sqrt(abs(covariance[p])) for p in PAIRS]
    for i, j, k in TRIPLES:
        # E[(a - m)(b - n)(c - o)] from raw moments.
        central = (
            third[i, j, k] / count
            - mean[i] * covariance[j, k]
            - mean[j] * covariance[i, k]
            - mean[k] * covariance[i, j]
            - mean[i] * mean[j] * mean[k]
        )
        values.append(np.cbrt(central))
    h, w = cloud.size
    values.append(np.sqrt(count / (h * w)))
    return np.array(values, np.float32)


@njit(cache=True, nogil=True, fastmath={"contract", "reassoc", "nsz"})
def raw_moments(
    points: NDArray[np.float32], mask: NDArray[np.bool_]
) -> tuple[float, NDArray[np.float64], NDArray[np.float64], NDArray[np.float64]]:
    """Count, and the sums of the points' coordinates, of their products, of their triples.

    Points outside the mask are 0 and add nothing. Rows are summed in single precision (a few
    hundred numbers below a metre), the rest in double.
    """
    _, h, w = points.shape
    first = np.zeros(3)
    second = np.zeros((3, 3))
    third = np.zeros((3, 3, 3))
    count = 0
    zero = np.float32(0.0)
    for y in range(h):
        px, py, pz, inside = points[0, y], points[1, y], points[2, y], mask[y]
        sx = sy = sz = xx = yy = zz = xy = xz = yz = zero
        xxx = xxy = xxz = xyy = xyz = xzz = yyy = yyz = yzz = zzz = zero
        n = 0
        for i in range(w):
            a, b, c = px[i], py[i], pz[i]
            n += 1 if inside[i] else 0
            aa, bb, cc = a * a, b * b, c * c
            sx += a
            sy += b
            sz += c
            xx += aa
            yy += bb
            zz += cc
            xy += a * b
            xz += a * c
            yz += b * c
            xxx += aa * a
            xxy += aa * b
            xxz += aa * c
            xyy += a * bb
            xyz += a * b * c
            xzz += a * cc
            yyy += bb * b
            yyz += bb * c
            yzz += b * cc
            zzz += cc * c
        count += n
        first += np.array([float(sx), float(sy), float(sz)])
        second[0, 0] += xx
        second[1, 1] += yy
        second[2, 2] += zz
        second[0, 1] += xy
        second[0, 2] += xz
        second[1, 2] += yz
        third[0, 0, 0] += xxx
        third[0, 0, 1] += xxy
        third[0, 0, 2] += xxz
        third[0, 1, 1] += xyy
        third[0, 1, 2] += xyz
        third[0, 2, 2] += xzz
        third[1, 1, 1] += yyy
        third[1, 1, 2] += yyz
        third[1, 2, 2] += yzz
        third[2, 2, 2] += zzz
    second[1, 0], second[2, 0], second[2, 1] = second[0, 1], second[0, 2], second[1, 2]
    return float(count), first, second, third
