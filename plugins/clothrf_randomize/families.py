"""The sensors: how large their errors are, from measurements and publications.

Axial noise is ``sigma(z, theta) = A(z) + B(z, A) g(theta)``, theta the angle between the surface's
normal and the ray, ``A = a0 + a1 z + a2 z^2`` and ``B = b0 A + (b1 + b2 z^2) / sqrt(z)``: every
published model has this form. `g` and the drop-outs are tabulated over cos^2(theta), so that a
pixel costs no trigonometric function.
"""

from __future__ import annotations

import dataclasses
from dataclasses import dataclass

import numpy as np

from clothrf_core.types import Float, Float32

COS_COUNT = 2048

# Probability of no depth below 1, 2, 4, 8, 16 pixels from an edge, and beyond: measured on real
# SR300 frames of a static cloth (pixels that are sometimes valid).
EDGE_DROP = (0.37, 0.105, 0.042, 0.013, 0.005, 0.0003)

Three = tuple[np.float32, np.float32, np.float32]


@dataclass(frozen=True, slots=True, eq=False)
class AxialSensor:
    """Errors of a sensor that are known as lengths along the ray.

    Attributes:
        a: a0 (m), a1, a2 (1/m).
        b: b0, b1 (m^1.5), b2 (m^-0.5).
        g: (2048,) float32 over cos^2(theta) from 0 to 1.
        drop: (2048,) float32 probability of no depth over cos^2(theta).
        jitter_px: lateral wobble of edges, pixels.
        smooth_share: low-frequency noise over axial noise.
        unit: one count of the depth picture, m.
        about_y: theta is the angle about the camera's y axis only.
    """

    a: Three
    b: Three
    g: Float32
    drop: Float32
    jitter_px: float
    smooth_share: float
    unit: float
    about_y: bool = False

    def sigma(self, z: Float, theta: Float) -> Float:
        """Standard deviation in metres at depth `z` (m) and incidence `theta` (rad)."""
        a0, a1, a2 = (float(v) for v in self.a)
        b0, b1, b2 = (float(v) for v in self.b)
        a = a0 + a1 * z + a2 * z**2
        index = np.rint(np.cos(theta) ** 2 * (COS_COUNT - 1)).astype(int)
        result: Float = a + self.g[index] * (b0 * a + (b1 + b2 * z**2) / np.sqrt(z))
        return result


@dataclass(frozen=True, slots=True)
class DisparitySensor:
    """Errors of a sensor that are known as disparities (pixels).

    Attributes:
        focal_baseline: f B, pixels times metres; 0 = the frame's fx times `baseline`.
        baseline: B, m.
        step_px: disparities are rounded to this, pixels.
        sigma_px: white noise of a disparity before rounding, pixels.
        cell_px: size of the patches that share a disparity error, pixels; 0 = white.
        jitter_px: wobble of the sampled pixel, pixels.
        window: pixels are dropped that a 9 x 9 window of dots cannot match.
        shadow: pixels are dropped that only one of the two cameras sees.
        unit: one count of the depth picture, m; 0 = not rounded again.
    """

    focal_baseline: float
    baseline: float
    step_px: float
    sigma_px: float
    cell_px: int
    jitter_px: float
    window: bool
    shadow: bool
    unit: float


def axial_sensor(family: str, *, cosine_drop: bool = False) -> AxialSensor:
    """The numbers of 'sr300', 'kinect' or 'd435'.

    Args:
        family: which of them.
        cosine_drop: the Kinect loses 1 - cos(theta) of its pixels instead of steep ones only.
    """
    theta = np.arccos(np.sqrt(np.arange(COS_COUNT) / (COS_COUNT - 1)))
    sensor = {"sr300": _sr300, "kinect": _kinect, "d435": _d435}[family](theta)
    if cosine_drop and family == "kinect":
        return dataclasses.replace(sensor, drop=(1.0 - np.cos(theta)).astype(np.float32))
    return sensor


def disparity_sensor(family: str) -> DisparitySensor:
    """The numbers of 'disparity' or 'stereo'."""
    if family == "disparity":
        # Handa et al. 2014 and Barron, Malik 2013 as in simkinect, with Bohg et al. 2014's window.
        # z_cm = 35130 / round(35130 / z_cm + N(0, 1/6)): steps of 1/8 px at f B = 43.9 px m. The
        # published rounding to whole centimetres is left out (useless below 1 m), so is the + 0.5,
        # which would shift every depth by half a step, and an earlier rounding to 1/8 px at
        # another baseline, which this one repeats.
        return DisparitySensor(
            focal_baseline=351.30 / 8.0,
            baseline=0.075,
            step_px=1.0 / 8.0,
            sigma_px=1.0 / 6.0 / 8.0,
            cell_px=0,
            jitter_px=0.5,
            window=True,
            shadow=False,
            unit=0.0,
        )
    # Active stereo: d = f B / z + 0.08 px of noise shared within the matching window, 1/32 px
    # (Grunnet-Jepsen et al., tuning guide of the D400 series); B of a D435.
    return DisparitySensor(
        focal_baseline=0.0,
        baseline=0.050,
        step_px=1.0 / 32.0,
        sigma_px=0.08,
        cell_px=4,
        jitter_px=0.0,
        window=False,
        shadow=True,
        unit=0.0,
    )


def _sr300(theta: Float) -> AxialSensor:
    """Coded light: sigma = 1.3e-3 z^2, fitted to real frames between 0.43 and 1.03 m."""
    degrees = np.degrees(theta)
    return AxialSensor(
        a=_three(0.0, 0.0, 1.3e-3),
        b=_three(1.0, 0.0, 0.0),
        g=((degrees / 60.0) ** 2).astype(np.float32),
        drop=_grazing(theta),
        jitter_px=0.5,
        smooth_share=1.0,
        unit=0.125e-3,
    )


def _kinect(theta: Float) -> AxialSensor:
    """Kinect v1 (Nguyen, Izadi, Lovell 2012, equations 1-3), theta limited to 85 degrees.

    sigma = 0.0012 + 0.0019 (z - 0.4)^2, beyond 60 degrees plus 0.0001 / sqrt(z) theta^2 /
    (pi / 2 - theta)^2.
    """
    limited = np.minimum(theta, np.radians(85.0))
    steep = limited**2 / (0.5 * np.pi - limited) ** 2
    return AxialSensor(
        a=_three(0.0012 + 0.0019 * 0.16, -0.0019 * 0.8, 0.0019),
        b=_three(0.0, 0.0001, 0.0),
        g=np.where(theta > np.radians(60.0), steep, 0.0).astype(np.float32),
        drop=_grazing(theta),
        jitter_px=0.8,
        smooth_share=0.0,
        unit=1e-3,
    )


def _d435(theta: Float) -> AxialSensor:
    """RealSense D435 (Ahn et al. 2019), theta about y only, limited to 80 degrees.

    sigma = 0.001063 + 0.0007278 z + 0.003949 z^2 + 0.022 z^1.5 theta / (pi / 2 - theta)^2.
    """
    limited = np.minimum(theta, np.radians(80.0))
    return AxialSensor(
        a=_three(0.001063, 0.0007278, 0.003949),
        b=_three(0.0, 0.0, 0.022),
        g=(limited / (0.5 * np.pi - limited) ** 2).astype(np.float32),
        drop=_grazing(theta),
        jitter_px=0.5,
        smooth_share=0.0,
        unit=1e-3,
        about_y=True,
    )


def _grazing(theta: Float) -> Float32:
    """Share of pixels lost: rises from 0 at 70 degrees to 1 at 90."""
    return np.clip((np.degrees(theta) - 70.0) / 20.0, 0.0, None).astype(np.float32)


def _three(x: float, y: float, z: float) -> Three:
    return np.float32(x), np.float32(y), np.float32(z)
