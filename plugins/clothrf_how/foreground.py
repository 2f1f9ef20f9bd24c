"""Which pixels are cloth: depth range, workspace box, colour, connected surfaces, holes."""

from __future__ import annotations

import bisect
from dataclasses import dataclass
from typing import NamedTuple

import cv2
import numpy as np
from numpy.typing import NDArray

from clothrf_core.camera_model import rays
from clothrf_core.rig import ForegroundSection
from clothrf_core.types import CameraModel, Float, Float32, RgbdFrame
from clothrf_how import colour_kernels as colour
from clothrf_how import foreground_kernels as kernels
from clothrf_how import mask_kernels, noise_kernels, surface_kernels
from clothrf_how.config import ForegroundOptions
from clothrf_how.rivals import fits_better

# Depths of one 2 x 2 block that are this close to its nearest are averaged, metres; across an edge
# the mean of near and far would be a point in the air. Of a noisy picture: so many deviations,
# slanted surfaces are noisier than the median, up to so many metres.
BLOCK = 0.015
WIDE = 30.0
FAR_APART = 0.4
# Noise of a pixel, metres, from which on depth is averaged over so many working pixels each way.
# A sensor (D435) twice as noisy as published made errors of 22 mm without, of 8 with this.
NOISY = (0.003, 0.006, 0.012)
CALM = (0, 2, 4, 6)
# Where more of the background than this has the cloth's colour, it does not say where cloth ends.
ALIKE = 0.5
# Further pieces that have the cloth's colour are kept from this share of the largest on.
OWN_SHARE = 0.003
# The states if what is odd were the cloth, and the cloth what is odd.
EXCHANGED = np.array(
    [kernels.UNMEASURED, kernels.ODD, kernels.ELSEWHERE, kernels.CANDIDATE, kernels.UNMEASURED],
    np.uint8,
)


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
    frame: RgbdFrame,
    view: View,
    where: ForegroundSection,
    options: ForegroundOptions,
    grasp: Float | None = None,
) -> Foreground:
    """The cloth of `frame`: the largest surface where cloth may be, and its further pieces.

    Args:
        frame: the picture.
        view: of its camera.
        where: cloth may be.
        options: of the features.
        grasp: (2, 3) world metres, where the robot holds the cloth; None or NaN = not known.
    """
    sigma = noise_kernels.noise(frame.depth, where.depth_min, where.depth_max)
    radius = CALM[bisect.bisect(NOISY, sigma)]
    z, state = _reduced(frame, view, where, sigma)
    roi = kernels.reach(state, kernels.CANDIDATE)
    if options.median > 1 and roi[3] > roi[1]:
        _calm(z, options.median, roi)
    told, odd = _told(state, frame, view, where, options, roi)
    cloth = _cloth(z, state, told, options, roi)
    if where.hue is None and 2 * odd > np.count_nonzero(cloth.mask):
        # Hands and arms may be more of the picture than a cloth that is half hidden, or lost to the
        # sensor: what is more of a sheet, and nearer to the grippers, is the cloth.
        other = EXCHANGED[state]
        told, odd = _told(other, frame, view, where, options, roi)
        if told is not None:
            rival = _cloth(z, other, told, options, roi)
            if fits_better(rival[:2], cloth[:2], view.directions, view.origin, grasp):
                state, cloth = other, rival
    mask, depth, roi = cloth
    if radius > 0:
        depth = noise_kernels.calmed(depth, mask, radius, roi)
        things = state == kernels.ODD
        z = np.where(things, noise_kernels.calmed(z, things, radius, roi), z)
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


def _reduced(
    frame: RgbdFrame, view: View, where: ForegroundSection, sigma: float
) -> tuple[Float32, NDArray[np.uint8]]:
    """Depth and state of the working pixels; `sigma` is the noise of the picture's, metres."""
    low, high = np.array(where.low, np.float32), np.array(where.high, np.float32)
    near, far = where.depth_min, where.depth_max
    if view.factor == 1:
        return kernels.reduce_pixels(
            frame.depth, near, far, view.directions, view.origin, low, high
        )
    # The nearest of noisy depths is too near.
    spread = BLOCK if sigma < NOISY[0] else min(WIDE * sigma, FAR_APART)
    return kernels.reduce_pairs(
        frame.depth, near, far, view.directions, view.origin, low, high, spread
    )


def _told(
    state: NDArray[np.uint8],
    frame: RgbdFrame,
    view: View,
    where: ForegroundSection,
    options: ForegroundOptions,
    roi: tuple[int, int, int, int],
) -> tuple[NDArray[np.uint8] | None, int]:
    """The shade of each pixel, None where colours say nothing; how many candidates were odd."""
    if where.hue is not None:
        own = hue_mask(block_colour(frame.rgb, view.factor), where)
        shade = np.where(own, np.uint8(colour.OWN), np.uint8(colour.OTHER))
        wrong = ~own & (state == kernels.CANDIDATE)
        state[wrong] = kernels.ODD
        return shade, int(np.count_nonzero(wrong))
    found = colour.cloth_colour(state, frame.rgb, view.factor, options.colour_tolerance, roi)
    if found.width <= 0.0:
        return None, 0
    rows = (roi[1] - options.complete, roi[3] + options.complete)
    shade = colour.shades(frame.rgb, view.factor, found, state.shape, rows)
    agree, odd = colour.mark_odd(state, shade, roi)
    if agree <= odd:
        return None, 0
    return shade, odd


def _calm(z: Float32, size: int, roi: tuple[int, int, int, int]) -> None:
    """Replace depths within `roi`, in place, by the median of `size` x `size` pixels about them."""
    around = size // 2
    x0, y0 = max(roi[0] - around, 0), max(roi[1] - around, 0)
    part = z[y0 : roi[3] + around, x0 : roi[2] + around]
    calm = np.asarray(cv2.medianBlur(src=np.ascontiguousarray(part), ksize=size), np.float32)
    box = (roi[0] - x0, roi[1] - y0, roi[2] - x0, roi[3] - y0)
    mask_kernels.replace_known(part, calm, box)


class _Cloth(NamedTuple):
    """The mask, its depth, and the box of all that may be cloth or touches it."""

    mask: NDArray[np.bool_]
    depth: Float32
    roi: tuple[int, int, int, int]


def _cloth(
    z: Float32,
    state: NDArray[np.uint8],
    shade: NDArray[np.uint8] | None,
    options: ForegroundOptions,
    roi: tuple[int, int, int, int],
) -> _Cloth:
    """The largest surface, its further pieces, holes bridged, and what has its colour."""
    label, area = surface_kernels.surfaces(z, state, options.jump, kernels.CANDIDATE, roi)
    share = options.keep_share if shade is None else OWN_SHARE
    kept = _pieces(label, area, z, share, options.stand_off, roi)
    mask, depth = mask_kernels.bridge(
        label, np.array(kept, np.int32), z, options.fill_gap, options.jump, roi
    )
    if (
        shade is not None
        and options.complete > 0
        and kept
        and colour.likeness(state, shade) < ALIKE
    ):
        large = area >= _least(area[kept[0]], options.keep_share)
        large[0] = False
        roi = colour.complete(
            mask, depth, z, state, shade, label, large, options.jump, options.stand_off,
            options.complete, roi,
        )  # fmt: skip
    return _Cloth(mask, depth, roi)


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


def _pieces(
    label: NDArray[np.int32],
    area: NDArray[np.int32],
    z: Float32,
    share: float,
    stand_off: float,
    roi: tuple[int, int, int, int],
) -> list[int]:
    """The largest piece, and large ones not far before or behind it where they meet it."""
    if area.size < 2:
        return []
    main = int(np.argmax(area))
    least = _least(area[main], share)
    further = [int(n) for n in np.flatnonzero(area >= least) if n != main]
    if further:
        meets = surface_kernels.apart(label, area, z, main, least, stand_off, roi)
        further = [n for n in further if 2 * meets[n, 0] <= meets[n, 1]]
    return [main, *further]


def _least(area: int, share: float) -> int:
    """Pixels of a piece that is looked at beside the largest, of `area` pixels."""
    return max(1, int(share * area))


def warm() -> None:
    """Compile (or load from the cache) every kernel, so that the first frame is not late."""
    one = np.zeros((2, 2), np.float32)
    ends = np.zeros(3, np.float32)
    box = (0, 0, 2, 2)
    kernels.reduce_pairs(one, 0.1, 1.0, np.zeros((3, 1, 1), np.float32), ends, ends, ends, 0.1)
    z, state = kernels.reduce_pixels(
        one, 0.1, 1.0, np.zeros((3, 2, 2), np.float32), ends, ends, ends
    )
    noise_kernels.noise(one, 0.1, 1.0)
    mask_kernels.replace_known(z, one, box)
    kernels.reach(state, kernels.CANDIDATE)
    rgb = np.zeros((2, 2, 3), np.uint8)
    found = colour.cloth_colour(state, rgb, 1, 0.1, box)
    shade = colour.shades(rgb, 1, found, state.shape, (0, 2))
    colour.mark_odd(state, shade, box)
    label, area = surface_kernels.surfaces(z, state, 0.1, kernels.CANDIDATE, box)
    surface_kernels.apart(label, area, z, 1, 1, 0.1, box)
    mask, depth = mask_kernels.bridge(label, area[1:], z, 1, 0.1, box)
    colour.likeness(state, shade)
    colour.complete(mask, depth, z, state, shade, label, area > 1, 0.1, 0.1, 1, box)
    mask_kernels.sums(mask, noise_kernels.calmed(depth, mask, 1, box), box)
