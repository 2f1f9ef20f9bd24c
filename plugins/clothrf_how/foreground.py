"""Which pixels are cloth: depth range, workspace box, colour, connected surfaces, holes."""

from __future__ import annotations

from dataclasses import dataclass

import cv2
import numpy as np
from numpy.typing import NDArray

from clothrf_core.camera_model import rays
from clothrf_core.rig import ForegroundSection
from clothrf_core.types import CameraModel, Float, Float32, RgbdFrame
from clothrf_how import foreground_kernels as kernels
from clothrf_how import mask_kernels, surface_kernels
from clothrf_how.config import ForegroundOptions


@dataclass(frozen=True, slots=True, eq=False)
class View:
    """A camera seen in working pixels (blocks of `factor` x `factor` picture pixels).

    Attributes:
        camera: the camera of the full picture.
        factor: picture pixels along a block's side.
        directions: (3, h, w) float32, world direction of each block's ray, of unit depth.
        origin: (3,) float32 camera centre, world, metres.
    """

    camera: CameraModel
    factor: int
    directions: Float32
    origin: Float32

    @classmethod
    def of(cls, camera: CameraModel, factor: int) -> View:
        """The view of `camera`; distortion is undone once, here."""
        h, w = camera.height // factor, camera.width // factor
        ray = rays(camera)[: h * factor, : w * factor].astype(np.float64)
        ray = ray.reshape(h, factor, w, factor, 2).mean(axis=(1, 3))
        local = np.concatenate([ray, np.ones((h, w, 1))], axis=2)
        world = local @ camera.T_world_camera[:3, :3].T
        return cls(
            camera=camera,
            factor=factor,
            directions=np.ascontiguousarray(world.transpose(2, 0, 1), dtype=np.float32),
            origin=camera.T_world_camera[:3, 3].astype(np.float32),
        )

    def shows(self, camera: CameraModel) -> bool:
        """Whether this view was made of a camera with the same numbers."""
        mine = self.camera
        return mine is camera or (
            (mine.width, mine.height) == (camera.width, camera.height)
            and np.array_equal(mine.K, camera.K)
            and np.array_equal(mine.T_world_camera, camera.T_world_camera)
            and np.array_equal(mine.distortion, camera.distortion)
        )


@dataclass(frozen=True, slots=True, eq=False)
class Foreground:
    """The cloth of one picture, in working pixels.

    Attributes:
        mask: (h, w) bool.
        depth: (h, w) float32, metres along the optical axis, holes bridged; 0 outside the mask.
        measured: (h, w) float32, depth of everything in the picture; 0 = not measured.
        state: (h, w) uint8, what each pixel is (`foreground_kernels`).
        view: where each pixel looks.
        area: pixels of the mask.
        centre: mean column, mean row (working pixels) and mean depth (metres); zeros if empty.
        box: (x0, y0, x1, y1) half-open bounding box of the mask; all 0 if it is empty.
        roi: the same of everything that may be cloth or touches it in front of the background.
        usable: False when there is too little to say anything.
    """

    mask: NDArray[np.bool_]
    depth: Float32
    measured: Float32
    state: NDArray[np.uint8]
    view: View
    area: int
    centre: tuple[float, float, float]
    box: tuple[int, int, int, int]
    roi: tuple[int, int, int, int]
    usable: bool


def foreground(
    frame: RgbdFrame, view: View, where: ForegroundSection, options: ForegroundOptions
) -> Foreground:
    """The cloth of `frame`: the largest surface where cloth may be, and its further pieces."""
    reduce = kernels.reduce_pairs if view.factor == 2 else kernels.reduce_pixels
    z, state = reduce(
        frame.depth,
        where.depth_min,
        where.depth_max,
        view.directions,
        view.origin,
        np.array(where.low, np.float32),
        np.array(where.high, np.float32),
    )
    if options.median > 1:
        calm = np.asarray(cv2.medianBlur(src=z, ksize=options.median), np.float32)
        np.copyto(z, calm, where=(z > 0.0) & (calm > 0.0))
    roi = kernels.reach(state, kernels.CANDIDATE)
    if where.hue is not None:
        wrong = ~hue_mask(block_colour(frame.rgb, view.factor), where)
        state[wrong & (state == kernels.CANDIDATE)] = kernels.ODD
    elif options.colour_tolerance > 0.0:
        kernels.odd_colours(state, frame.rgb, view.factor, options.colour_tolerance, roi)
    label, area = surface_kernels.surfaces(z, state, options.jump, kernels.CANDIDATE, roi)
    mask = label == _largest(area)
    for piece in _further_pieces(label, area, z, options, roi):
        mask |= label == piece
    mask, depth = mask_kernels.bridge(mask, z, options.fill_gap, options.jump, roi)
    box = mask_kernels.bounds(mask, roi)
    count, u, v, total = mask_kernels.sums(mask, depth, box)
    many = max(count, 1)
    return Foreground(
        mask=mask,
        depth=depth,
        measured=z,
        state=state,
        view=view,
        area=count,
        centre=(u / many, v / many, total / many),
        box=box,
        roi=roi,
        usable=count >= max(16.0, options.min_share * mask.size),
    )


def block_colour(rgb: NDArray[np.uint8], factor: int) -> NDArray[np.uint8]:
    """(h, w, 3) uint8 mean colour of each block."""
    if factor == 1:
        return rgb
    h, w = rgb.shape[0] // factor, rgb.shape[1] // factor
    cut = np.ascontiguousarray(rgb[: h * factor, : w * factor])
    shrunk = cv2.resize(src=cut, dsize=(w, h), interpolation=cv2.INTER_AREA)
    return np.asarray(shrunk, np.uint8)


def hue_mask(rgb: NDArray[np.uint8], where: ForegroundSection) -> NDArray[np.bool_]:
    """(h, w) bool: pixels in the rig's hue range with enough saturation and value (HSV)."""
    if where.hue is None:
        return np.ones(rgb.shape[:2], bool)
    hsv = cv2.cvtColor(src=rgb, code=cv2.COLOR_RGB2HSV_FULL)
    hue = hsv[:, :, 0].astype(np.float32) * (360.0 / 256.0)
    first, second = (h % 360.0 for h in where.hue)
    inside = (hue >= first) & (hue <= second)
    if first > second:
        inside = (hue >= first) | (hue <= second)
    result: NDArray[np.bool_] = (
        inside
        & (hsv[:, :, 1] >= 255.0 * where.saturation_min)
        & (hsv[:, :, 2] >= 255.0 * where.value_min)
    )
    return result


def anchor(area: Foreground) -> Float:
    """(3,) world metres: the middle pixel of the foreground, back-projected at its mean depth.

    Alignment moves the foreground to the middle of the picture; this is what it removed.
    """
    u, v, depth = area.centre
    view = area.view
    h, w = area.mask.shape
    # The ray between four pixels, bilinear: exact for a pinhole, smooth for a lens.
    x, y = min(int(u), w - 2), min(int(v), h - 2)
    fx, fy = u - x, v - y
    d = view.directions[:, y : y + 2, x : x + 2].astype(np.float64)
    ray = d @ np.array([1.0 - fx, fx])
    ray = ray @ np.array([1.0 - fy, fy])
    point: Float = view.camera.T_world_camera[:3, 3] + depth * ray
    return point


def _largest(area: NDArray[np.int32]) -> int:
    return int(np.argmax(area)) if area.size > 1 else -1


def _further_pieces(
    label: NDArray[np.int32],
    area: NDArray[np.int32],
    z: Float32,
    options: ForegroundOptions,
    roi: tuple[int, int, int, int],
) -> list[int]:
    """Pieces large enough that are not far before or behind the largest one where they meet it."""
    main = _largest(area)
    least = max(1, int(options.keep_share * area[main])) if main > 0 else 1
    pieces = [int(n) for n in np.flatnonzero(area >= least) if n != main]
    if not pieces:
        return []
    meets = surface_kernels.apart(label, area, z, main, least, options.stand_off, roi)
    return [n for n in pieces if 2 * meets[n, 0] <= meets[n, 1]]


def warm() -> None:
    """Compile (or load from the cache) every kernel, so that the first frame is not late."""
    one = np.zeros((2, 2), np.float32)
    ends = np.zeros(3, np.float32)
    kernels.reduce_pairs(one, 0.1, 1.0, np.zeros((3, 1, 1), np.float32), ends, ends, ends)
    z, state = kernels.reduce_pixels(
        one, 0.1, 1.0, np.zeros((3, 2, 2), np.float32), ends, ends, ends
    )
    kernels.reach(state, kernels.CANDIDATE)
    kernels.odd_colours(state, np.zeros((2, 2, 3), np.uint8), 1, 0.1, (0, 0, 2, 2))
    label, area = surface_kernels.surfaces(z, state, 0.1, kernels.CANDIDATE, (0, 0, 2, 2))
    surface_kernels.apart(label, area, z, 1, 1, 0.1, (0, 0, 2, 2))
    mask_kernels.sums(*mask_kernels.bridge(state > 0, z, 1, 0.1, (0, 0, 2, 2)), (0, 0, 2, 2))
