"""Judges a camera file on pictures that were never used to make it."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass

import numpy as np

from clothrf_calibration import rigid
from clothrf_calibration.boardpose import fit_pose
from clothrf_calibration.lens import directions, project
from clothrf_calibration.views import View
from clothrf_core.types import Float, Float32

RESAMPLES = 200


@dataclass(frozen=True, slots=True)
class Spread:
    """A number over views, and how repeatable it is.

    Attributes:
        value: root mean square (or median, where said) over the views.
        sd: standard deviation of that number over bootstrap resamples of the views.
        low: 2.5th percentile of the resamples.
        high: 97.5th percentile.
        worst: largest view.
    """

    value: float
    sd: float
    low: float
    high: float
    worst: float


@dataclass(frozen=True, slots=True)
class Verification:
    """What new pictures say about a camera file.

    Attributes:
        views: pictures with a board.
        reprojection_px: pose of every board refitted; corners against projections.
        lateral_mm: the same at the board's distance, across the line of sight.
        point_mm: 3-D corners from the depth picture against the board; None without depth.
        depth_bias_mm: median of measured minus true depth at the board; None without depth.
        depth_scale: slope of measured over true depth; None without depth or spread.
        depth_noise_mm: standard deviation about that line.
        hand_eye_mm: board where it is seen against where the robot says; None without poses.
        hand_eye_deg: the same for its rotation.
        hand_eye_px: corners seen against corners predicted from the robot's pose alone.
    """

    views: int
    reprojection_px: Spread
    lateral_mm: Spread
    point_mm: Spread | None = None
    depth_bias_mm: Spread | None = None
    depth_scale: float | None = None
    depth_noise_mm: float | None = None
    hand_eye_mm: Spread | None = None
    hand_eye_deg: Spread | None = None
    hand_eye_px: Spread | None = None

    def rows(self) -> list[tuple[str, str]]:
        """What was measured, and the numbers, for a table."""
        found: list[tuple[str, str]] = [("pictures", str(self.views))]
        for name, value, unit in (
            ("reprojection error", self.reprojection_px, "px"),
            ("the same, at the board", self.lateral_mm, "mm"),
            ("3-D points against the board", self.point_mm, "mm"),
            ("depth bias at the board", self.depth_bias_mm, "mm"),
            ("board, seen against robot", self.hand_eye_mm, "mm"),
            ("the same, rotation", self.hand_eye_deg, "deg"),
            ("the same, corners", self.hand_eye_px, "px"),
        ):
            if value is not None:
                found.append(
                    (
                        f"{name} ({unit})",
                        f"{value.value:.3f}  [{value.low:.3f} .. {value.high:.3f}], worst view "
                        f"{value.worst:.3f}",
                    )
                )
        if self.depth_scale is not None:
            found.append(("depth scale", f"{self.depth_scale:.5f}"))
        if self.depth_noise_mm is not None:
            found.append(("depth noise (mm)", f"{self.depth_noise_mm:.3f}"))
        return found


def verify(
    views: Sequence[View],
    points: Float,
    intrinsics: Float,
    *,
    depths: Mapping[str, Float32] | None = None,
    predicted: Mapping[str, Float] | None = None,
    rng: np.random.Generator,
) -> Verification:
    """Judge intrinsics, depth and camera pose on `views`.

    Args:
        views: of pictures that took no part in the calibration.
        points: (P, 3) of the board.
        intrinsics: intrinsic vector.
        depths: view -> (H, W) float32 metres, NaN where not measured.
        predicted: view -> (4, 4) T_camera_board that the robot's pose says.
        rng: for the bootstrap.
    """
    px, mm, point, bias, pairs = [], [], [], [], []
    robot: list[tuple[float, float, float]] = []
    for view in views:
        T, residual = fit_pose(intrinsics, points, view)
        local = points[view.ids] @ T[:3, :3].T + T[:3, 3]
        px.append(_rms(residual))
        mm.append(1e3 * _rms(residual / intrinsics[:2] * local[:, 2:]))
        if depths is not None and view.name in depths:
            measured = _sampled(depths[view.name], view.pixels)
            good = np.isfinite(measured)
            if good.sum() >= 6:
                point.append(_points_error(intrinsics, view, measured, points, good))
                bias.append(1e3 * float(np.median((measured - local[:, 2])[good])))
                pairs.append(np.stack([local[good, 2], measured[good]], axis=1))
        if predicted is not None and view.name in predicted:
            robot.append(_robot_error(predicted[view.name], T, points, view, intrinsics))
    scale, noise = _line(np.concatenate(pairs)) if pairs else (None, None)
    seen = np.array(robot).reshape(-1, 3)
    return Verification(
        views=len(views),
        reprojection_px=_spread(px, rng),
        lateral_mm=_spread(mm, rng),
        point_mm=_spread(point, rng) if point else None,
        depth_bias_mm=_spread(bias, rng, root=False) if bias else None,
        depth_scale=scale,
        depth_noise_mm=noise,
        hand_eye_mm=_spread(seen[:, 0], rng) if robot else None,
        hand_eye_deg=_spread(seen[:, 1], rng) if robot else None,
        hand_eye_px=_spread(seen[:, 2], rng) if robot else None,
    )


def _spread(
    values: Sequence[float] | Float, rng: np.random.Generator, *, root: bool = True
) -> Spread:
    x = np.asarray(values, float)
    picks = rng.integers(0, len(x), (RESAMPLES, len(x)))
    made = np.sqrt((x[picks] ** 2).mean(axis=1)) if root else np.median(x[picks], axis=1)
    value = float(np.sqrt((x**2).mean())) if root else float(np.median(x))
    low, high = np.percentile(made, (2.5, 97.5))
    return Spread(value, float(made.std()), float(low), float(high), float(x[np.argmax(np.abs(x))]))


def _rms(vectors: Float) -> float:
    return float(np.sqrt((vectors**2).sum(axis=1).mean()))


def _sampled(depth: Float32, pixels: Float) -> Float:
    """(N,) median of the 3 x 3 depths about each pixel; NaN if fewer than five are measured."""
    h, w = depth.shape
    u = np.clip(np.round(pixels[:, 0]).astype(int), 1, w - 2)
    v = np.clip(np.round(pixels[:, 1]).astype(int), 1, h - 2)
    dv, du = (g.ravel() for g in np.mgrid[-1:2, -1:2])
    patch = depth[v[:, None] + dv, u[:, None] + du].astype(float)
    out = np.full(len(pixels), np.nan)
    enough = np.isfinite(patch).sum(axis=1) >= 5
    out[enough] = np.nanmedian(patch[enough], axis=1)
    return out


def _points_error(
    intrinsics: Float,
    view: View,
    depth: Float,
    points: Float,
    good: np.ndarray[tuple[int, ...], np.dtype[np.bool_]],
) -> float:
    """RMS distance, mm, of 3-D corners to the board's after the best rigid fit (Horn 1987)."""
    xy = directions(intrinsics, view.pixels[good])
    measured = np.concatenate([xy, np.ones((len(xy), 1))], axis=1) * depth[good, None]
    drawn = points[view.ids[good]]
    a, b = drawn - drawn.mean(axis=0), measured - measured.mean(axis=0)
    U, _, Vt = np.linalg.svd(a.T @ b)
    R = Vt.T @ np.diag([1.0, 1.0, np.linalg.det(Vt.T @ U.T)]) @ U.T
    return 1e3 * _rms(b - a @ R.T)


def _line(pairs: Float) -> tuple[float | None, float]:
    """Slope of measured over true depth (None if all at one distance) and the noise in mm."""
    true, measured = pairs[:, 0], pairs[:, 1]
    noise = 1.4826e3 * float(np.median(np.abs(measured - true - np.median(measured - true))))
    if np.ptp(true) < 0.05 * true.mean():
        return None, noise
    slope, offset = np.polyfit(true, measured, 1)
    rest = measured - slope * true - offset
    return float(slope), 1.4826e3 * float(np.median(np.abs(rest - np.median(rest))))


def _robot_error(
    predicted: Float, T: Float, points: Float, view: View, intrinsics: Float
) -> tuple[float, float, float]:

    middle = points.mean(axis=0)
    a, b = (M[:3, :3] @ middle + M[:3, 3] for M in (predicted, T))
    local = points[view.ids] @ predicted[:3, :3].T + predicted[:3, 3]
    pixels = project(intrinsics, local)
    return (
        1e3 * float(np.linalg.norm(a - b)),
        float(rigid.angle_deg(predicted[:3, :3] @ T[:3, :3].T)),
        _rms(pixels - view.pixels),
    )
