"""Figures of a run. Every function returns a figure or bytes; nothing is written here."""

from __future__ import annotations

import contextlib
import io
from collections.abc import Iterator, Mapping, Sequence
from typing import Any

import numpy as np
from numpy.typing import NDArray

from clothrf_core.errors import MissingDependency

INK, BLUE, ORANGE, GREY = "#22262b", "#1f6f8b", "#d9772b", "#8a9199"


def _pyplot() -> Any:
    try:
        import matplotlib as mpl
    except ImportError as error:
        raise MissingDependency(
            "plots need 'matplotlib', which is not installed. "
            "Install it with: pip install 'clothrf[plot]'"
        ) from error
    mpl.use("Agg")
    import matplotlib.pyplot as plt

    return plt


def house_axes(width: float = 6.4, height: float = 3.6, columns: int = 1) -> tuple[Any, Any]:
    """An empty figure of one row in the house style, and its axes."""
    plt = _pyplot()
    figure, axes = plt.subplots(1, columns, figsize=(width, height), layout="constrained")
    for axis in np.atleast_1d(axes):
        axis.spines[["top", "right"]].set_visible(False)
        axis.grid(color="#e3e6e8", linewidth=0.7)
        axis.set_axisbelow(True)
    return figure, axes


def convergence(records: Sequence[Mapping[str, Any]]) -> Any:
    """Held-out error per task and number of leaves over the DAgger iterations."""
    has_leaves = all("leaves" in r for r in records)
    figure, axes = house_axes(9.0 if has_leaves else 5.4, 3.4, 2 if has_leaves else 1)
    left = np.atleast_1d(axes)[0]
    x = [r["iteration"] for r in records]
    for task in records[0]["tasks"]:
        left.plot(x, [r["tasks"][task]["rms_mm"] for r in records], marker=".", label=task)
    left.set(xlabel="DAgger iteration", ylabel="held-out RMS per coordinate, mm")
    _from_zero(left)
    left.legend(frameon=False, loc="lower left")
    if has_leaves:
        right = axes[1]
        right.plot(x, [r["leaves"] for r in records], marker=".", color=INK)
        right.set(xlabel="DAgger iteration", ylabel="leaves of the forest")
        _from_zero(right)
    for axis in np.atleast_1d(axes):
        axis.set_xlim(x[0] - 0.5, x[-1] + 0.5)
        axis.xaxis.get_major_locator().set_params(integer=True, min_n_ticks=1)
    return figure


def closed_loop(table: Sequence[Mapping[str, Any]]) -> Any:
    """Mean grasp error of controllers with 95 % intervals; one bar a controller and task."""
    figure, axis = house_axes(1.8 + 1.1 * len(table), 3.4)
    for i, row in enumerate(table):
        colour = GREY if row["controller"] == "expert" else BLUE
        axis.bar(i, row["mean_mm"], yerr=row["half_mm"], color=colour, width=0.62, capsize=4)
        axis.annotate(
            f"{row['mean_mm']:.1f}",
            (i, row["mean_mm"] + (row["half_mm"] or 0)),
            ha="center",
            va="bottom",
            fontsize=9,
            xytext=(0, 2),
            textcoords="offset points",
        )
    labels = [f"{row['controller']}\n{row['task']}" for row in table]
    axis.set_xticks(range(len(table)), labels)
    axis.set(ylabel="mean grasp error, mm")
    axis.margins(y=0.12)
    axis.grid(axis="x", visible=False)
    return figure


def confidence(curve: NDArray[np.float64]) -> Any:
    """What a stated confidence is worth: RMS error against confidence."""
    figure, axis = house_axes(4.8, 3.4)
    axis.plot(curve[:, 0], curve[:, 1], marker="o", color=BLUE)
    for c, rms, n in curve:
        axis.annotate(f"{n:.0f}", (c, rms), xytext=(0, 5), textcoords="offset points", fontsize=7)
    axis.set(xlabel="confidence", ylabel="RMS error, mm", xlim=(0, 1))
    _from_zero(axis)
    return figure


def _from_zero(axis: Any) -> None:
    """Lines begin at 0 and leave room above, also where they hardly rise or fall."""
    axis.set_ylim(0.0, 1.1 * max((np.nanmax(line.get_ydata()) for line in axis.lines), default=1.0))


@contextlib.contextmanager
def fixed_ids() -> Iterator[None]:
    """Equal figures written as SVG give equal bytes inside this block."""
    _pyplot()
    import matplotlib as mpl

    with mpl.rc_context({"svg.hashsalt": "clothrf"}):
        yield


def png(figure: Any, *, dpi: int = 130) -> bytes:
    """A figure as PNG; equal figures give equal bytes."""
    buffer = io.BytesIO()
    figure.savefig(buffer, format="png", dpi=dpi, metadata={"Software": None})
    _pyplot().close(figure)
    return buffer.getvalue()


def picture_png(rgb: NDArray[np.uint8]) -> bytes:
    """(H, W, 3) uint8 as PNG."""
    from PIL import Image

    buffer = io.BytesIO()
    Image.fromarray(rgb).save(buffer, format="PNG")
    return buffer.getvalue()


def animation_gif(frames: Sequence[NDArray[np.uint8]], *, frame_s: float) -> bytes:
    """(H, W, 3) uint8 frames as a looping GIF with one common palette."""
    from PIL import Image

    images = [Image.fromarray(frame) for frame in frames]
    palette = images[len(images) // 2].quantize(colors=128)
    quantised = [i.quantize(palette=palette, dither=Image.Dither.NONE) for i in images]
    buffer = io.BytesIO()
    quantised[0].save(
        buffer,
        format="GIF",
        save_all=True,
        append_images=quantised[1:],
        duration=max(20, round(1000 * frame_s)),
        loop=0,
    )
    return buffer.getvalue()
