from __future__ import annotations

import dataclasses
import itertools

import numpy as np
import pytest
from clothrf_how import colour_kernels as colour
from clothrf_how import foreground_kernels as kernels
from clothrf_how import mask_kernels, noise_kernels, surface_kernels
from clothrf_how.config import FeatureOptions, ForegroundOptions
from clothrf_how.extractor import Extractor
from clothrf_how.foreground import View, anchor, foreground, hue_mask

from clothrf_core.camera_model import project
from clothrf_core.rig import ForegroundSection


@pytest.fixture
def find(rig):
    def run(frame, **options):
        chosen = ForegroundOptions(**options)
        view = View.of(frame.camera, 2 if chosen.halve else 1)
        return foreground(frame, view, rig.foreground, chosen)

    return run


def _with(frame, depth, rgb=None):
    return dataclasses.replace(frame, depth=depth, rgb=frame.rgb if rgb is None else rgb)


def _truth(sheet):
    return np.isfinite(sheet.depth)[::2, ::2]


def _overlap(a, b):
    return (a & b).sum() / (a | b).sum()


def test_the_sheet_is_found(sheet, find):
    area = find(sheet)

    assert area.usable
    assert _overlap(area.mask, _truth(sheet)) > 0.98
    rows, columns = np.nonzero(area.mask)
    assert area.box == (columns.min(), rows.min(), columns.max() + 1, rows.max() + 1)
    assert area.area == rows.size
    want = (columns.mean(), rows.mean(), area.depth[area.mask].mean(dtype=float))
    assert area.centre == pytest.approx(want)


def test_a_background_behind_the_cloth_is_not_cloth(sheet, find):
    depth = np.where(np.isnan(sheet.depth), np.float32(0.85), sheet.depth)

    assert _overlap(find(_with(sheet, depth)).mask, _truth(sheet)) > 0.98


def test_an_arm_of_another_colour_in_front_is_not_cloth(sheet, find):
    depth, rgb = np.array(sheet.depth), np.array(sheet.rgb)
    depth[:, 250:330] = 0.30
    rgb[:, 250:330] = (150, 150, 150)

    mask = find(_with(sheet, depth, rgb)).mask

    assert not mask[:, 127:163].any()
    assert mask[:, :125].any()
    assert mask[:, 168:].any()


def test_cloth_on_both_sides_of_an_arm_is_kept(sheet, find):
    depth, rgb = np.array(sheet.depth), np.array(sheet.rgb)
    depth[:, 250:330] = 0.30
    rgb[:, 250:330] = (150, 150, 150)

    mask = find(_with(sheet, depth, rgb)).mask

    truth = _truth(sheet)
    truth[:, 125:165] = False
    assert _overlap(mask, truth) > 0.95


def test_a_finger_thin_thing_in_front_is_bridged(sheet, find):
    depth, rgb = np.array(sheet.depth), np.array(sheet.rgb)
    depth[150:300, 300:312] = 0.3
    rgb[150:300, 300:312] = (200, 150, 130)

    area = find(_with(sheet, depth, rgb))

    assert area.mask[80:145, 150:156].all()
    assert np.abs(area.depth[80:145, 152] - area.depth[80:145, 148]).max() < 0.01


def test_small_holes_are_bridged_and_large_ones_are_not(sheet, find):
    depth, rgb = np.array(sheet.depth), np.array(sheet.rgb)
    depth[200:210, 300:310] = np.nan
    depth[240:300, 300:360] = np.nan
    rgb[240:300, 300:360] = (190, 180, 170)

    mask = find(_with(sheet, depth, rgb)).mask

    assert mask[100:105, 150:155].all()
    assert not mask[130:140, 160:170].any()


def test_a_slit_through_which_the_background_is_seen_is_not_bridged(sheet, find):
    depth = np.array(sheet.depth)
    depth[200:300, 300:310] = 0.80

    assert not find(_with(sheet, depth)).mask[101:149, 151:154].any()


def test_noise_and_flicker_do_not_change_the_mask_much(sheet, find):
    rng = np.random.default_rng(0)
    depth = sheet.depth + rng.normal(0, 2e-3, sheet.depth.shape).astype(np.float32)
    depth[rng.random(depth.shape) < 0.1] = np.nan

    assert _overlap(find(_with(sheet, depth)).mask, _truth(sheet)) > 0.96


def test_hue_tells_cloth_from_a_hand_that_touches_it(rig, sheet):
    depth, rgb = np.array(sheet.depth), np.array(sheet.rgb)
    rgb[300:400, 100:200] = (200, 150, 120)
    where = ForegroundSection(**{**rig.foreground.model_dump(), "hue": [150.0, 210.0]})
    view = View.of(sheet.camera, 2)

    area = foreground(_with(sheet, depth, rgb), view, where, ForegroundOptions(fill_gap=0))

    assert not area.mask[151:199, 51:99].any()
    assert area.usable


def test_a_hue_range_wraps_around_red():
    where = ForegroundSection(low=[0, 0, 0], high=[1, 1, 1], hue=[340.0, 20.0])
    colours = np.array([[[200, 30, 30], [30, 200, 30], [200, 30, 60]]], np.uint8)

    assert hue_mask(colours, where).tolist() == [[True, False, True]]


def test_a_few_pixels_are_not_usable(sheet, find):
    depth = np.full_like(sheet.depth, np.nan)
    depth[200:206, 300:306] = 0.45

    assert not find(_with(sheet, depth)).usable


def test_a_cut_off_cloth_is_usable(sheet, find):
    depth = np.array(sheet.depth)
    depth[:, 160:] = np.nan

    assert find(_with(sheet, depth)).usable


def test_the_anchor_projects_onto_the_middle_of_the_mask(sheet, find):
    area = find(sheet)

    pixel, _ = project(sheet.camera, anchor(area)[None])

    rows, columns = np.nonzero(area.mask)
    middle = np.array([columns.mean(), rows.mean()]) * 2.0 + 0.5
    np.testing.assert_allclose(pixel[0], middle, atol=0.05)


def test_distortion_is_undone(rig, sheet, observe):
    camera = dataclasses.replace(sheet.camera, distortion=np.array([0.1, -0.05, 0.001, 0.0]))
    frame = dataclasses.replace(sheet, camera=camera)

    view = View.of(camera, 1)

    points = (view.origin[:, None] + 0.5 * view.directions[:, 100:400:50, 200]).T
    pixels, _ = project(camera, points.astype(float))
    np.testing.assert_allclose(pixels[:, 0], 200.0, atol=0.01)
    np.testing.assert_allclose(pixels[:, 1], np.arange(100, 400, 50), atol=0.01)
    assert Extractor(FeatureOptions(), rig).extract(observe(frame)).valid


@pytest.mark.parametrize("factor", [1, 2])
def test_the_compiled_block_reduction_equals_numpy(rig, sheet, factor):
    rng = np.random.default_rng(0)
    depth = np.array(sheet.depth)
    kind = rng.integers(0, 12, depth.shape)
    for value, code in ((np.nan, 0), (0.0, 1), (np.inf, 2), (-1.0, 3), (0.1, 4), (2.0, 5)):
        depth[kind == code] = value
    where = rig.foreground
    view = View.of(sheet.camera, factor)
    low, high = np.array(where.low, np.float32), np.array(where.high, np.float32)

    given = (depth, where.depth_min, where.depth_max, view.directions, view.origin, low, high)
    if factor == 2:
        z, state = kernels.reduce_pairs(*given, 0.015)
    else:
        z, state = kernels.reduce_pixels(*given)

    want_z, want_state = _reduced(depth, where, view, low, high)
    np.testing.assert_array_equal(state, want_state)
    assert set(np.unique(state)) == {0, 1, 2}
    np.testing.assert_allclose(z, want_z, rtol=1e-6)


def _reduced(depth, where, view, low, high):
    n = view.factor
    h, w = depth.shape[0] // n, depth.shape[1] // n
    block = depth.reshape(h, n, w, n).transpose(0, 2, 1, 3).reshape(h, w, n * n)
    near, far = np.float32(where.depth_min), np.float32(where.depth_max)
    with np.errstate(invalid="ignore"):
        inside = (block >= near) & (block <= far)
        nearest = np.where(inside, block, np.inf).min(axis=2)
        close = inside & (block <= nearest[..., None] + np.float32(0.015))
        farthest = np.where((block > 0) & (block < np.inf), block, 0.0).max(axis=2)
    total = np.where(close, block, 0).sum(axis=2)
    z = np.where(np.isinf(nearest), farthest, total / np.maximum(close.sum(axis=2), 1))
    point = view.origin[:, None, None] + z * view.directions
    ok = ((point >= low[:, None, None]) & (point <= high[:, None, None])).all(axis=0)
    state = np.where(ok & ~np.isinf(nearest), 1, np.where(z > 0, 2, 0))
    return z, state


def test_the_compiled_surfaces_equal_a_flood_fill():
    rng = np.random.default_rng(2)
    h, w = 30, 40
    z = (0.5 + 0.02 * rng.integers(0, 3, (h, w))).astype(np.float32)
    state = (rng.random((h, w)) < 0.8).astype(np.uint8)

    label, area = surface_kernels.surfaces(
        z, state, 0.03, kernels.CANDIDATE, kernels.reach(state, kernels.CANDIDATE)
    )

    want = np.zeros((h, w), int)
    number = 0
    for y in range(h):
        for x in range(w):
            if state[y, x] != 1 or want[y, x]:
                continue
            number += 1
            want[y, x] = number
            stack = [(y, x)]
            while stack:
                j, i = stack.pop()
                for b, a in ((j - 1, i), (j + 1, i), (j, i - 1), (j, i + 1)):
                    if (
                        0 <= b < h
                        and 0 <= a < w
                        and state[b, a] == 1
                        and not want[b, a]
                        and abs(z[b, a] - z[j, i]) < np.float32(0.03)
                    ):
                        want[b, a] = number
                        stack.append((b, a))
    np.testing.assert_array_equal(label, want)
    np.testing.assert_array_equal(area[1:], np.bincount(want.ravel())[1:])


def test_the_compiled_bridge_equals_plain_python():
    rng = np.random.default_rng(4)
    label = rng.integers(0, 4, (25, 35)).astype(np.int32)
    mask = (label == 1) | (label == 3)
    z = np.where(mask, 0.5 + 0.01 * rng.random(mask.shape), 0.0).astype(np.float32)
    behind = ~mask & (rng.random(mask.shape) < 0.2)
    z[behind] = 0.9

    full, depth = mask_kernels.bridge(label, np.array([3, 1], np.int32), z, 3, 0.02, (0, 0, 35, 25))

    want, values = _bridged(mask, np.where(mask, z, 0), z)
    turned, turned_values = _bridged(want.T, values.T, z.T)
    np.testing.assert_array_equal(full, turned.T)
    np.testing.assert_allclose(depth, turned_values.T, atol=1e-6)


def _bridged(mask, depth, z, gap=3, jump=0.02):
    full, values = mask.copy(), depth.astype(np.float32)
    for y in range(mask.shape[0]):
        inside = np.flatnonzero(mask[y])
        for a, b in itertools.pairwise(inside):
            if not 1 < b - a <= gap + 1:
                continue
            between = np.arange(a + 1, b)
            line = np.interp(between, [a, b], [depth[y, a], depth[y, b]])
            if abs(depth[y, b] - depth[y, a]) <= jump and (z[y, between] <= line + jump).all():
                full[y, between] = True
                values[y, between] = line
    return full, values


def test_a_bar_of_the_cloths_colour_before_the_cloth_is_not_cloth(sheet, find):
    depth = np.array(sheet.depth)
    depth[:, 280:310] = 0.21

    mask = find(_with(sheet, depth)).mask

    assert not mask[:, 142:153].any()
    assert mask[:, :138].any()
    assert mask[:, 157:].any()


def _met(label, z):
    area = np.bincount(label.ravel()).astype(np.int32)
    return surface_kernels.apart(label, area, z, 1, 1, 0.1, (0, 0, *label.shape[::-1])).tolist()


def test_meeting_pieces_are_counted():
    label = np.array([[1, 1, 0, 2, 2, 0, 0, 0, 0, 0, 3]], np.int32)
    z = np.where(label == 2, 0.3, 0.5).astype(np.float32)

    # Both pixels of piece 2 are within four of piece 1 and 0.2 m before it; piece 3 is farther
    # away, but not before it.
    assert _met(label, z) == [[0, 0], [0, 0], [2, 2], [0, 1]]


def test_past_the_background_a_piece_must_go_on_at_the_cloths_depth():
    label = np.array([[1, 1] + [0] * 8 + [2, 2]], np.int32)
    hidden = np.where(label == 1, 0.5, np.where(label == 2, 0.42, 0.3)).astype(np.float32)
    open_ = np.where(label == 0, 0.0, hidden).astype(np.float32)

    # Something at 0.3 m parts the pieces, or nothing is measured between them.
    assert _met(label, hidden)[2] == [0, 2]
    assert _met(label, open_)[2] == [2, 2]


def test_a_piece_that_meets_nothing_must_not_be_before_all_of_the_cloth():
    label = np.diag([1, 0, 0, 2, 0, 3]).astype(np.int32)
    z = np.select([label == 2, label == 3], [0.4, 0.48], 0.5).astype(np.float32)

    assert _met(label, z) == [[0, 0], [0, 0], [1, 1], [0, 0]]


def test_the_reach_of_a_state_is_its_bounding_box():
    state = np.zeros((7, 9), np.uint8)

    assert kernels.reach(state, 2) == (0, 0, 0, 0)
    state[2, 5] = state[4, 1] = 2

    assert kernels.reach(state, 2) == (1, 2, 6, 5)
    assert kernels.reach(state, 0) == (0, 0, 9, 7)


def _colours():
    rgb = np.full((40, 40, 3), (30, 120, 130), np.uint8)
    rgb[:10] = (200, 150, 130)
    return rgb


def _shaded(state, rgb, tolerance=0.08):
    box = (0, 0, *state.shape[::-1])
    found = colour.cloth_colour(state, rgb, 1, tolerance, box)
    shade = colour.shades(rgb, 1, found, state.shape, (0, len(state)))
    return shade, colour.mark_odd(state, shade, box)


def test_odd_colours_are_marked():
    state = np.ones((40, 40), np.uint8)

    _, counts = _shaded(state, _colours())

    assert counts == (1200, 400)
    assert (state[:10] == kernels.ODD).all()
    assert (state[10:] == kernels.CANDIDATE).all()


def test_a_cloth_of_many_colours_has_no_odd_ones():
    state = np.ones((40, 40), np.uint8)
    many = np.random.default_rng(0).integers(40, 255, (40, 40, 3)).astype(np.uint8)

    _, (agree, differ) = _shaded(state, many, tolerance=0.02)

    assert agree < differ
    assert (state == kernels.CANDIDATE).all()


def test_dark_pixels_have_no_colour():
    rgb = _colours()
    rgb[:, :5] = 3

    shade, _ = _shaded(np.ones((40, 40), np.uint8), rgb)

    assert (shade[:, :5] == colour.UNTOLD).all()
    assert colour.cloth_colour(np.ones((9, 9), np.uint8), rgb[:9, :5], 1, 0.1, (0, 0, 5, 9))[2] == 0


@pytest.mark.parametrize("factor", [1, 2, 3])
def test_the_compiled_shades_equal_numpy(factor):
    rng = np.random.default_rng(3)
    rgb = rng.integers(0, 256, (24, 36, 3)).astype(np.uint8)
    rgb[: 2 * factor] //= 20
    h, w = 24 // factor, 36 // factor
    wanted = colour.Colour(np.float32(0.3), np.float32(0.35), np.float32(0.1))

    got = colour.shades(rgb, factor, wanted, (h, w), (0, h))

    first = rgb[::factor, ::factor].astype(np.float32)
    total = first.sum(axis=2)
    off = np.abs(first[..., :2] - total[..., None] * np.array([0.3, 0.35], np.float32)).max(axis=2)
    near = off <= 0.1 * total + 4
    clear = np.abs(off - 0.1 * total - 4) > 1e-3
    want = np.where(total < colour.DARK, colour.UNTOLD, np.where(near, colour.OWN, colour.OTHER))
    np.testing.assert_array_equal(got[clear], want[clear])
    assert set(np.unique(got)) == {0, 1, 2}


def test_cloth_that_the_sensor_lost_is_grown_by_its_colour(sheet, find):
    depth = np.array(sheet.depth)
    columns = np.flatnonzero(np.isfinite(depth).any(axis=0))
    depth[240:300, 300:360] = np.nan
    depth[:, : columns[0] + 50] = np.nan

    area = find(_with(sheet, depth))

    assert _overlap(area.mask, _truth(sheet)) > 0.98
    assert np.abs(area.depth - sheet.depth[::2, ::2])[area.mask & _truth(sheet)].max() < 0.05


def test_a_background_of_the_cloths_colour_grows_nothing(sheet, find):
    rgb = np.full_like(sheet.rgb, (30, 120, 130))

    assert _overlap(find(_with(sheet, sheet.depth, rgb)).mask, _truth(sheet)) > 0.98


def test_hands_larger_than_what_is_left_of_the_cloth_are_not_the_cloth(sheet, find):
    depth, rgb = np.array(sheet.depth), np.array(sheet.rgb)
    left = int(np.flatnonzero(np.isfinite(depth).any(axis=0))[0])
    hand, lost, end = left + 100, left + 170, left + 220
    depth[:, hand:lost] = depth[:, end:] = np.nan
    rgb[:, end:] = 0
    rgb[:, :hand][np.isfinite(depth[:, :hand])] = (200, 150, 130)

    mask = find(_with(sheet, depth, rgb)).mask

    assert not mask[:, : hand // 2 - 1].any()
    assert mask[:, hand // 2 + 5 : end // 2 - 1].mean() > 0.5


def test_the_noise_of_a_picture_is_measured(sheet):
    rng = np.random.default_rng(5)
    for sigma in (0.001, 0.004, 0.012):
        depth = sheet.depth + rng.normal(0, sigma, sheet.depth.shape).astype(np.float32)
        assert noise_kernels.noise(depth, 0.1, 2.0) == pytest.approx(sigma, rel=0.15)
    assert noise_kernels.noise(np.full((64, 64), np.nan, np.float32), 0.1, 2.0) == 0.0


def test_a_noisy_picture_is_calmed_without_bias(sheet, find):
    rng = np.random.default_rng(6)
    depth = sheet.depth + rng.normal(0, 0.02, sheet.depth.shape).astype(np.float32)

    noisy, clean = find(_with(sheet, depth)), find(sheet)

    both = noisy.mask & clean.mask
    assert _overlap(noisy.mask, clean.mask) > 0.95
    wrong = (noisy.depth - clean.depth)[both]
    assert abs(wrong.mean()) < 0.002
    assert wrong.std() < 0.006


def test_the_compiled_calming_equals_numpy():
    rng = np.random.default_rng(7)
    mask = rng.random((20, 30)) < 0.6
    mask[:3] = mask[:, :2] = False
    depth = np.where(mask, rng.random((20, 30)), 0.0).astype(np.float32)

    got = noise_kernels.calmed(depth, mask, 2, (2, 3, 30, 20))

    want = np.zeros((20, 30))
    for y, x in np.argwhere(mask):
        part = np.s_[max(y - 2, 0) : y + 3, max(x - 2, 0) : x + 3]
        want[y, x] = depth[part].sum() / mask[part].sum()
    np.testing.assert_allclose(got, want, atol=1e-5)
