"""HOW, the histogram of oriented wrinkles: Gabor answers of the cloth, summed over a grid.

Jia, Hu, Pan, Manocha, "Manipulating Highly Deformable Materials Using a Visual Feedback
Dictionary" (ICRA 2018), algorithm 1: the feature of orientation i and cell (x, y) is the block sum
of the i-th filter's answer. Steps here: foreground -> relief (depth minus the cloth's plane, in
millimetres) -> alignment -> oriented answers -> rectified -> block sums in the order
(orientation, column, row) -> divided by their sum.

768 = 4 orientations x 16 x 12 cells (layout A; B, C and D are other ways to 768).
"""

from __future__ import annotations

import math

import cv2
import numpy as np
from numpy.typing import NDArray

from clothrf_core.types import Float, Float32, RgbdFrame
from clothrf_how import how_kernels as kernels
from clothrf_how.config import HowOptions
from clothrf_how.foreground import Foreground, block_colour
from clothrf_how.gabor import Factors, bank, factors
from clothrf_how.mask_kernels import bounds
from clothrf_how.passes import Board, Grid, Passes

# Layout: orientations, wavelengths, cell columns, cell rows.
LAYOUTS = {"A": (4, 1, 16, 12), "B": (8, 1, 8, 6), "C": (8, 2, 8, 6), "D": (1, 1, 32, 24)}

EPSILON = 1e-9


def how_names(options: HowOptions) -> tuple[str, ...]:
    """768 names: ``how_o0_c03_r11`` is orientation 0, cell column 3, cell row 11."""
    orientations, wavelengths, columns, rows = LAYOUTS[options.layout]
    cells = [f"c{c:02d}_r{r:02d}" for c in range(columns) for r in range(rows)]
    if options.layout == "D":
        return tuple(f"how_depth_{cell}" for cell in cells)
    kinds = [""]
    if options.layout == "B":
        kinds = ["grey_", "depth_"]
    if options.layout == "C":
        kinds = [f"l{i}_" for i in range(wavelengths)]
    return tuple(
        f"how_{kind}o{i}_{cell}" for kind in kinds for i in range(orientations) for cell in cells
    )


class How:
    """The histogram of one configuration; kernels are made once."""

    def __init__(self, options: HowOptions) -> None:
        self.options = options
        self.names = how_names(options)
        self._separable = _is_separable(options)
        self._passes = (
            tuple(Passes.of(a, b) for a, b in zip(*_quadrature(options), strict=True))
            if self._separable
            else ()
        )

    def __call__(self, area: Foreground, frame: RgbdFrame) -> Float32:
        """(768,) float32 of a usable foreground."""
        options = self.options
        _, _, columns, rows = LAYOUTS[options.layout]
        pictures = [_picture(channel, area, frame, options) for channel in _channels(options)]
        mask, box, pictures = _aligned(area, pictures, options)
        if box[2] == box[0]:
            return np.zeros(len(self.names), np.float32)
        offset = _offset(area, options)
        grid = _grid(box, mask.shape, offset, (rows, columns))
        if options.layout == "D":
            parts = [_block_means(pictures[0], mask, box, grid)]
        else:
            parts = [part for p in pictures for part in self._answers(p, mask, box, grid)]
        values = np.concatenate([part.T.ravel() for part in parts])
        if options.normalise == "l1" and options.layout != "D":
            values = values / (values.sum() + EPSILON)
        return values.astype(np.float32)

    def _answers(
        self,
        picture: Float32,
        mask: NDArray[np.bool_],
        box: tuple[int, int, int, int],
        grid: Grid,
    ) -> list[Float]:
        if self._separable:
            margin = max(p.margin for p in self._passes)
            board = Board.of(picture, mask, box, grid, margin)
            turned = board.turned()
            return [p.sums(board, turned, self.options) for p in self._passes]
        orientations, wavelengths, _, _ = LAYOUTS[self.options.layout]
        lengths = (self.options.wavelength, self.options.second_wavelength)[:wavelengths]
        return [
            sums
            for length in lengths
            for sums in filtered_sums(
                picture, mask, box, grid, self.options, orientations=orientations, wavelength=length
            )
        ]


def filtered_sums(
    picture: Float32,
    mask: NDArray[np.bool_],
    box: tuple[int, int, int, int],
    grid: Grid,
    options: HowOptions,
    *,
    orientations: int,
    wavelength: float,
) -> list[Float]:
    """Block sums by `cv2.filter2D`: any number of orientations, the published square kernels."""
    x0, y0, x1, y1 = box
    inside = mask[y0:y1, x0:x1]
    m = options.kernel_size // 2
    padded = surrounded(picture, box, m)

    def answers(psi: float) -> list[Float32]:
        kernels_2d = bank(options, orientations=orientations, wavelength=wavelength, psi=psi)
        filtered = [cv2.filter2D(src=padded, ddepth=cv2.CV_32F, kernel=k) for k in kernels_2d]
        return [np.asarray(picture[m:-m, m:-m], np.float32) for picture in filtered]

    waves = answers(options.psi)
    if options.response == "energy":
        quarter = answers(options.psi + math.pi / 2.0)
        waves = [
            np.asarray(np.hypot(a, b), np.float32) for a, b in zip(waves, quarter, strict=True)
        ]
    return [cell_sums(rectified(a, options.response) * inside, grid) for a in waves]


def surrounded(picture: Float32, box: tuple[int, int, int, int], margin: int) -> Float32:
    """The box of a picture and `margin` pixels around it; zeros outside the picture."""
    x0, y0, x1, y1 = box
    h, w = picture.shape
    result = np.zeros((y1 - y0 + 2 * margin, x1 - x0 + 2 * margin), np.float32)
    top, left = max(0, y0 - margin), max(0, x0 - margin)
    cut = picture[top : min(h, y1 + margin), left : min(w, x1 + margin)]
    j, i = top - (y0 - margin), left - (x0 - margin)
    result[j : j + cut.shape[0], i : i + cut.shape[1]] = cut
    return result


def rectified(answer: Float32, response: str) -> Float32:
    """What an answer counts: its positive part, magnitude, or what 8 bits hold of it."""
    if response == "half":
        return np.maximum(answer, np.float32(0.0))
    if response == "saturate8":
        return np.clip(answer, np.float32(0.0), np.float32(255.0))
    return np.abs(answer)


def cell_sums(values: Float32, grid: Grid) -> Float:
    """(rows, columns) float64 sums of (bh, bw) values over the grid's cells."""
    rows, columns = grid.shape
    y = np.clip(grid.rows, -1, rows)
    x = np.clip(grid.columns, -1, columns)
    # One spare cell on every side takes what falls outside the grid.
    index = (y[:, None] + 1) * (columns + 2) + x[None, :] + 1
    weights = values.ravel().astype(np.float64)
    total = np.bincount(index.ravel(), weights=weights, minlength=(rows + 2) * (columns + 2))
    inner = total.reshape(rows + 2, columns + 2)[1:-1, 1:-1]
    return inner.astype(np.float64)


def relief(area: Foreground, kind: str) -> Float32:
    """(h, w) float32 millimetres that the cloth stands out of its own plane; 0 outside the mask.

    Subtracting median, plane or quadric (least squares over the foreground, in pixel coordinates)
    takes the cloth's place and slope out of the picture, so that the wrinkles are what is left.
    """
    if kind == "median":
        base = np.float32(np.median(area.depth[area.mask]))
        flat = np.where(area.mask, np.float32(1000.0) * (area.depth - base), 0.0)
        return flat.astype(np.float32)
    return kernels.detrended(area.depth, area.mask, 1 if kind == "plane" else 2, area.box)


def _picture(channel: str, area: Foreground, frame: RgbdFrame, options: HowOptions) -> Float32:
    if channel == "grey":
        grey = cv2.cvtColor(src=block_colour(frame.rgb, area.view.factor), code=cv2.COLOR_RGB2GRAY)
        h, w = area.mask.shape
        return np.ascontiguousarray(grey[:h, :w], dtype=np.float32)
    if options.layout == "D":
        return area.depth
    return relief(area, options.relief)


def _channels(options: HowOptions) -> tuple[str, ...]:
    if options.layout == "B":
        return ("grey", "depth")
    return ("depth",) if options.layout == "D" else (options.channel,)


def _is_separable(options: HowOptions) -> bool:
    """Whether the fast passes apply: four orientations, and the kernels of `gabor.factors`."""
    return options.layout == "A" and options.zero_mean and options.unit_norm


def _quadrature(options: HowOptions) -> tuple[tuple[Factors, ...], tuple[Factors, ...]]:
    return factors(options, psi=options.psi), factors(options, psi=options.psi + math.pi / 2.0)


def _aligned(
    area: Foreground, pictures: list[Float32], options: HowOptions
) -> tuple[NDArray[np.bool_], tuple[int, int, int, int], list[Float32]]:
    """Mask, its box and pictures moved and scaled; moving alone is left to the grid: exact."""
    if options.align != "center_scale":
        return area.mask, area.box, pictures
    h, w = area.mask.shape
    x0, y0, x1, y1 = area.box
    u, v, _ = area.centre
    # The larger side of the bounding box becomes 0.8 of the picture's.
    scale = 0.8 * min(w / (x1 - x0), h / (y1 - y0))
    matrix = np.array(
        [
            [scale, 0.0, 0.5 * (w - 1) - scale * u],
            [0.0, scale, 0.5 * (h - 1) - scale * v],
        ]
    )

    def warp(picture: Float32) -> Float32:
        moved = cv2.warpAffine(
            src=picture, M=matrix, dsize=(w, h), flags=cv2.INTER_LINEAR, borderValue=0.0
        )
        return np.asarray(moved, np.float32)

    share = warp(area.mask.astype(np.float32))
    mask = share > 0.5
    moved = [np.where(mask, warp(p) / np.maximum(share, 0.5), 0.0) for p in pictures]
    return mask, bounds(mask, (0, 0, w, h)), [p.astype(np.float32) for p in moved]


def _offset(area: Foreground, options: HowOptions) -> tuple[int, int]:
    """Columns and rows that the picture is moved by under the grid: whole pixels."""
    if options.align != "center":
        return (0, 0)
    h, w = area.mask.shape
    u, v, _ = area.centre
    return (round(0.5 * (w - 1) - u), round(0.5 * (h - 1) - v))


def _grid(
    box: tuple[int, int, int, int],
    shape: tuple[int, int],
    offset: tuple[int, int],
    cells: tuple[int, int],
) -> Grid:
    x0, y0, x1, y1 = box
    h, w = shape
    rows, columns = cells
    y = np.arange(y0, y1) + offset[1]
    x = np.arange(x0, x1) + offset[0]
    return Grid(
        rows=(y * rows // h).astype(np.int32),
        columns=(x * columns // w).astype(np.int32),
        shape=cells,
        first=(int(y[0]) % 2, int(x[0]) % 2),
    )


def _block_means(
    depth: Float32, mask: NDArray[np.bool_], box: tuple[int, int, int, int], grid: Grid
) -> Float:
    x0, y0, x1, y1 = box
    inside = mask[y0:y1, x0:x1]
    count = cell_sums(inside.astype(np.float32), grid)
    total = cell_sums(depth[y0:y1, x0:x1] * inside, grid)
    means: Float = total / np.maximum(count, 1.0)
    return means
