"""The pictures of a report, each a PNG."""

from __future__ import annotations

import io
from collections.abc import Sequence
from typing import Any

import matplotlib as mpl
import numpy as np
from matplotlib.backends.backend_agg import FigureCanvasAgg
from matplotlib.figure import Figure

from clothrf_calibration.coverage import CELLS, cell_counts
from clothrf_calibration.uncertainty import UncertaintyMap
from clothrf_calibration.views import View
from clothrf_core.types import CameraModel, Float


def png(figure: Figure) -> bytes:
    """The figure as a PNG file."""
    buffer = io.BytesIO()
    figure.savefig(buffer, format="png", dpi=110, bbox_inches="tight")
    return buffer.getvalue()


def coverage_plot(views: Sequence[View]) -> bytes:
    """Every corner of every view, over the cells of the picture."""
    width, height = views[0].size
    figure, axes = _picture(width, height)
    counts = cell_counts(views, (width, height)).astype(float)
    axes.imshow(
        np.where(counts > 0, np.log1p(counts), np.nan),
        extent=(-0.5, width - 0.5, height - 0.5, -0.5),
        cmap="Greens", vmin=0, alpha=0.7,
    )  # fmt: skip
    colours = mpl.colormaps["turbo"](np.linspace(0, 1, len(views)))
    for view, colour in zip(views, colours, strict=True):
        axes.plot(view.pixels[:, 0], view.pixels[:, 1], ".", ms=2.5, color=colour)
    for i in range(1, CELLS[0]):
        axes.axhline(height * i / CELLS[0], color="0.8", lw=0.5)
    for j in range(1, CELLS[1]):
        axes.axvline(width * j / CELLS[1], color="0.8", lw=0.5)
    axes.set_title("Corners; white cells are not covered")
    return png(figure)


def residual_plot(views: Sequence[View], residuals: Sequence[Float]) -> bytes:
    """Residual vectors where they were measured, enlarged."""
    width, height = views[0].size
    figure, axes = _picture(width, height)
    pixels = np.concatenate([v.pixels for v in views])
    error = np.concatenate(list(residuals))
    size = np.linalg.norm(error, axis=1)
    typical = float(np.percentile(size, 90)) or 1.0
    factor = 0.035 * width / typical
    drawn = axes.quiver(
        pixels[:, 0], pixels[:, 1], factor * error[:, 0], factor * error[:, 1], size,
        angles="xy", scale_units="xy", scale=1, cmap="viridis", clim=(0, 2 * typical), width=0.0018,
    )  # fmt: skip
    figure.colorbar(drawn, ax=axes, label="px", fraction=0.035)
    axes.set_title(f"Residual vectors, {factor:.0f} times enlarged; a pattern means a wrong model")
    return png(figure)


def uncertainty_plot(found: UncertaintyMap) -> bytes:
    """Standard deviation of projections over the picture."""
    width, height = float(found.columns[-1]) + 1, float(found.rows[-1]) + 1
    figure, axes = _picture(width, height)
    top = max(float(np.percentile(found.sd, 95)), 0.1)
    drawn = axes.contourf(found.columns, found.rows, found.sd, levels=np.linspace(0, top, 21),
                          extend="max", cmap="inferno")  # fmt: skip
    lines = axes.contour(found.columns, found.rows, found.sd, levels=[0.1, 0.3, 1.0, 3.0],
                         colors="w", linewidths=0.8)  # fmt: skip
    axes.clabel(lines, fmt="%g px", fontsize=7)
    figure.colorbar(drawn, ax=axes, label="px (one standard deviation)", fraction=0.035)
    axes.set_title(f"Projection uncertainty: mean {found.mean:.2f}, worst {found.worst:.2f} px")
    return png(figure)


def views_plot(names: Sequence[str], rms: Float, *, held_out: Float | None = None) -> bytes:
    """Residual of every view, and of the same view when it was held out."""
    figure = _figure(max(5.0, 0.22 * len(names) + 1.5), 2.6)
    axes = figure.add_subplot()
    x = np.arange(len(names))
    axes.bar(x, rms, color="tab:green", label="in the fit")
    if held_out is not None and len(held_out) == len(names):
        axes.plot(x, held_out, "k_", ms=9, label="held out")
        axes.legend(fontsize=7)
    axes.set_xticks(x, names, rotation=90, fontsize=6)
    axes.set_ylabel("RMS, px")
    axes.set_title("Residual of every view")
    return png(figure)


def rig_plot(
    camera: CameraModel, boards: Sequence[Float], grippers: Sequence[Float], points: Float
) -> bytes:
    """Frames of the rig in 3-D: base, camera with its field of view, boards, grippers."""
    figure = _figure(7.0, 6.0)
    axes: Any = figure.add_subplot(projection="3d")
    low, high = points[:, :2].min(axis=0), points[:, :2].max(axis=0)
    outline = np.array([[low[0], low[1], 0], [high[0], low[1], 0], [high[0], high[1], 0],
                        [low[0], high[1], 0], [low[0], low[1], 0]])  # fmt: skip
    seen = [np.zeros(3), camera.T_world_camera[:3, 3]]
    reach = 0.25
    if boards:
        middle = np.mean([B[:3, 3] for B in boards], axis=0)
        reach = 0.35 * float(np.linalg.norm(middle - camera.T_world_camera[:3, 3]))
    for B in boards:
        line = outline @ B[:3, :3].T + B[:3, 3]
        axes.plot(*line.T, color="tab:orange", lw=0.8)
        seen += list(line)
    for G in grippers:
        _frame(axes, G, 0.15 * reach, "", lw=0.6)
        seen.append(G[:3, 3])
    _frame(axes, np.eye(4), 0.5 * reach, "base")
    _frame(axes, camera.T_world_camera, 0.5 * reach, "camera")
    corners = np.array([[0, 0], [camera.width, 0], [camera.width, camera.height],
                        [0, camera.height]], float)  # fmt: skip
    ray = (corners - camera.K[:2, 2]) / np.diag(camera.K)[:2]
    tips = camera.T_world_camera
    ends = reach * np.concatenate([ray, np.ones((4, 1))], axis=1) @ tips[:3, :3].T + tips[:3, 3]
    for n in range(4):
        axes.plot(*np.stack([tips[:3, 3], ends[n]]).T, color="0.4", lw=0.8)
        axes.plot(*np.stack([ends[n], ends[(n + 1) % 4]]).T, color="0.4", lw=0.8)
    box = np.array(seen)
    centre, half = (box.max(0) + box.min(0)) / 2, max(float(np.ptp(box, axis=0).max()) / 2, 0.1)
    for set_limits, c in zip((axes.set_xlim, axes.set_ylim, axes.set_zlim), centre, strict=True):
        set_limits(c - half, c + half)
    axes.set_xlabel("x, m")
    axes.set_ylabel("y, m")
    axes.set_zlabel("z, m")
    axes.set_title("The rig: x red, y green, z blue; boards orange")
    return png(figure)


def _frame(axes: Any, T: Float, length: float, name: str, *, lw: float = 1.6) -> None:
    for k, colour in enumerate(("r", "g", "b")):
        axes.plot(*np.stack([T[:3, 3], T[:3, 3] + length * T[:3, k]]).T, color=colour, lw=lw)
    if name:
        axes.text(*T[:3, 3], name, fontsize=8)


def _picture(width: float, height: float) -> tuple[Figure, Any]:
    figure = _figure(6.4, 6.4 * height / width)
    axes = figure.add_subplot()
    axes.set_xlim(-0.5, width - 0.5)
    axes.set_ylim(height - 0.5, -0.5)
    axes.set_aspect("equal")
    return figure, axes


def _figure(width: float, height: float) -> Figure:
    figure = Figure(figsize=(width, height))
    FigureCanvasAgg(figure)
    return figure
