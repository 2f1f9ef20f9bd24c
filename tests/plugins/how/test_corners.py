from __future__ import annotations

import dataclasses

import numpy as np
import pytest
from clothrf_how.cloud import Cloud
from clothrf_how.config import ForegroundOptions
from clothrf_how.corners import (
    Corners,
    cases,
    cases_names,
    corners,
    corners_names,
    edge,
    farthest,
    find_corners,
    outward,
)
from clothrf_how.foreground import View, anchor, foreground
from clothrf_how.foreground_kernels import GROWN
from clothrf_how.holders import GAP, LEAST_AREA, Layout, find_holders, slots, tip, touches

from clothrf_core.camera_model import back_project, project
from clothrf_core.scene import Label, sphere

SKIN = (200, 150, 130)
STEEL = (150, 152, 155)


def _with_arm(frame, start, away, colour, radius=0.018):
    """The picture with a capsule from `start` along `away`, drawn as points of spheres."""
    balls = [
        sphere(start + s * away, radius, Label.HAND, (0.5, 0.5, 0.5), segments=60).vertices
        for s in np.linspace(0.01, 0.12, 45)
    ]
    pixels, z = project(frame.camera, np.concatenate(balls))
    depth, rgb = np.array(frame.depth), np.array(frame.rgb)
    for (u, v), d in zip(np.rint(pixels).astype(int), z, strict=True):
        if 0 <= u < 640 and 0 <= v < 480 and not depth[v, u] < d:
            depth[v, u] = d
            rgb[v, u] = colour
    return dataclasses.replace(frame, depth=depth, rgb=rgb)


@pytest.fixture(scope="module")
def held(rig, sheet):
    """The sheet, moved so that all its corners are seen, with hands and one gripper."""
    camera = sheet.camera
    back = dataclasses.replace(
        camera, T_world_camera=_moved(camera.T_world_camera, [0.12, 0.0, 0.14])
    )
    nearer = rig.camera.model_copy(update={"T_world_camera": back.T_world_camera.tolist()})
    moved = rig.model_copy(update={"camera": nearer})
    from clothrf_core.testing.features import draw_sheet

    frame = draw_sheet(moved)
    for hand in rig.rest_hands:
        frame = _with_arm(frame, hand, np.array([0.9, 0.0, -0.43]), SKIN)
    frame = _with_arm(frame, rig.rest_grasp[1], np.array([-0.7, 0.0, 0.71]), STEEL, 0.012)
    area = foreground(frame, View.of(back, 2), rig.foreground, ForegroundOptions())
    return frame, area


def _moved(T, by):
    T = np.array(T)
    T[:3, 3] += by
    return T


def test_hands_and_gripper_are_found_where_they_touch(rig, held):
    _, area = held
    middle = anchor(area)

    found = find_holders(area, middle, Layout.of(rig))

    assert found.seen.tolist() == [True, True, False, True]
    truth = np.concatenate([rig.rest_hands, rig.rest_grasp]) - middle
    for slot in (0, 1, 3):
        assert np.linalg.norm(found.points[slot] - truth[slot]) < 0.03
        assert np.linalg.norm(found.tips[slot] - truth[slot]) < 0.03
    assert found.away[0] @ Layout.of(rig).towards_hands > 0.02
    assert found.away[3] @ Layout.of(rig).towards_hands < -0.01


def test_what_holds_is_not_cloth(held):
    frame, area = held

    cloth = (frame.rgb[::2, ::2] == (30, 120, 130)).all(axis=2)
    odd = (frame.rgb[::2, ::2] == SKIN).all(axis=2)
    assert (area.mask & cloth).sum() > 0.98 * cloth.sum()
    assert (area.mask & odd).sum() < 0.1 * odd.sum()


def test_an_arm_that_only_hides_the_cloth_is_no_holder(rig, sheet):
    depth, rgb = np.array(sheet.depth), np.array(sheet.rgb)
    depth[:, 250:330] = 0.22
    rgb[:, 250:330] = SKIN
    frame = dataclasses.replace(sheet, depth=depth, rgb=rgb)
    area = foreground(frame, View.of(frame.camera, 2), rig.foreground, ForegroundOptions())

    assert not find_holders(area, anchor(area), Layout.of(rig)).seen.any()


def test_a_fringe_of_the_rim_in_the_backgrounds_colour_is_no_holder(rig, sheet):
    rgb = np.array(sheet.rgb)
    finite = np.isfinite(sheet.depth)
    rim = finite & ~np.roll(finite, 4, axis=1)
    rgb[rim] = (190, 180, 170)
    frame = dataclasses.replace(sheet, rgb=rgb)
    area = foreground(frame, View.of(frame.camera, 2), rig.foreground, ForegroundOptions())

    assert not find_holders(area, anchor(area), Layout.of(rig)).seen.any()


def test_without_holders_corners_are_the_outermost_points(rig, sheet):
    area = foreground(sheet, View.of(sheet.camera, 2), rig.foreground, ForegroundOptions())
    middle = anchor(area)
    layout = Layout.of(rig)
    cloud = Cloud.of(area, middle)

    found = find_corners(cloud, find_holders(area, middle, layout), layout)

    assert not found.seen.any()
    truth = rig.rest_hands - middle
    assert np.linalg.norm(found.points[:2] - truth, axis=1).max() < 0.03
    np.testing.assert_array_equal(found.points, found.tips)


def test_a_dark_picture_has_no_holders(rig, held):
    frame, _ = held
    dark = dataclasses.replace(frame, rgb=np.zeros_like(frame.rgb))
    area = foreground(dark, View.of(frame.camera, 2), rig.foreground, ForegroundOptions())

    assert not find_holders(area, anchor(area), Layout.of(rig)).seen.any()


def test_the_edges_normals_are_the_experts():
    start, end = np.array([0.1, -0.15, 0.0]), np.array([0.05, 0.15, 0.04])
    d = end - start
    c = np.cross([0, 0, 1.0], d)
    c /= np.linalg.norm(c)
    n = np.cross(d, np.cross([0, 0, 1.0], d))
    n /= np.linalg.norm(n)

    values = edge(start, end)

    np.testing.assert_allclose(values[:2], c[:2], atol=1e-12)
    np.testing.assert_allclose(values[4:7], n, atol=1e-12)
    assert values[2] == pytest.approx(np.hypot(d[0], d[1]))
    assert values[3] == pytest.approx(0.04)
    assert values[7] == pytest.approx(np.linalg.norm(d))


def test_an_edge_without_length_is_finite():
    assert np.isfinite(edge(np.zeros(3), np.zeros(3))).all()
    assert np.isfinite(edge(np.zeros(3), np.array([0.0, 0.0, 0.3]))).all()


def test_names_fit_and_a_case_fills_its_own_block_only():
    rng = np.random.default_rng(0)
    parts = (rng.random((4, 3)) for _ in range(3))
    found = Corners(np.array([True, False, True, True]), *parts, rng.random(4), 0.1)

    assert corners(found).shape == (len(corners_names()),)
    blocks = cases(found).reshape(4, -1)
    assert blocks.size == len(cases_names())
    assert len(set(cases_names())) == blocks.size
    assert [bool(b.any()) for b in blocks] == [False, False, True, False]
    assert blocks[2, 0] == 1.0


LEVEL = Layout(np.array([1.0, 0.0, 0.0]), np.array([0.0, 1.0, 0.0]))


def in_slots(middle, reach, grasp):
    middle, reach = np.array(middle, float), np.array(reach, float)
    known = np.zeros((0, 3)) if grasp is None else grasp
    ways = (LEVEL.towards_hands, LEVEL.across)
    found = slots(middle, middle, reach, np.full(len(middle), 50.0), *ways, np.zeros(3), known)
    return {slot: which for slot, which in enumerate(found.tolist()) if which >= 0}


def test_grippers_above_each_other_are_told_apart_by_where_they_are_measured():
    grasp = np.array([[-0.2, 0.0, 0.1], [-0.2, 0.0, -0.1]])
    # Across, the second thing comes first; measured, it is the second gripper.
    things = [[-0.2, 0.01, 0.1], [-0.2, -0.01, -0.1]]

    assert in_slots(things, np.zeros((2, 3)), grasp) == {2: 0, 3: 1}
    assert in_slots(things, np.zeros((2, 3)), None) == {2: 1, 3: 0}


def test_a_gripper_on_the_persons_side_of_the_cloth_is_no_hand_if_it_is_measured_there():
    grasp = np.array([[0.1, -0.15, 0.0], [0.1, 0.15, 0.0]])

    found = in_slots([[0.1, 0.14, 0.0], [0.2, 0.1, 0.0]], [[0.0, 0.0, 0.0], [0.05, 0, 0]], grasp)

    assert found == {3: 0, 1: 1}


def test_an_unmeasured_grasp_is_what_the_picture_says():
    things, reach = [[0.2, -0.1, 0.0], [-0.2, 0.1, 0.0]], [[0.05, 0, 0], [-0.05, 0, 0]]

    assert in_slots(things, reach, None) == {0: 0, 3: 1}


def test_the_robots_corners_are_where_it_measures_them(rig, held):
    _, area = held
    middle, layout = anchor(area), Layout.of(rig)
    cloud, grasp = Cloud.of(area, middle), rig.rest_grasp - middle + 0.004
    holders = find_holders(area, middle, layout, grasp)

    known = find_corners(cloud, holders, layout, grasp)
    unknown = find_corners(cloud, holders, layout, np.full((2, 3), np.nan))

    np.testing.assert_allclose(known.points[2:], grasp)
    assert np.isfinite(unknown.points).all()
    assert np.linalg.norm(unknown.points[2:] - grasp, axis=1).max() < 0.06


def test_what_is_neither_cloth_nor_holder_is_foreign(rig, held):
    frame, area = held
    clean = find_holders(area, anchor(area), Layout.of(rig))
    over = frame.camera.T_world_camera[:3, 3] * 0.4 + anchor(area) * 0.6
    strange = _with_arm(frame, over, np.array([0.0, 1.0, 0.0]), SKIN, 0.03)
    there = foreground(strange, area.view, rig.foreground, ForegroundOptions())

    found = find_holders(there, anchor(there), Layout.of(rig))

    assert clean.foreign < 0.002
    assert found.foreign > clean.foreign + 0.01


def test_without_a_rig_the_person_stands_behind_the_camera(rig):
    guess = Layout.facing(rig.camera.model().T_world_camera)
    known = Layout.of(rig)

    assert guess.towards_hands @ known.towards_hands > 0.95
    assert guess.across @ known.across > 0.95


def test_compiled_farthest_points_equal_numpy():
    rng = np.random.default_rng(0)
    mask = rng.random((20, 30)) < 0.7
    points = (rng.random((3, 20, 30)) * mask).astype(np.float32)
    rig_layout = Layout(np.array([1.0, 0.0, 0.0]), np.array([0.0, 1.0, 0.0]))
    ways = outward(rig_layout)

    got = farthest(points, mask, ways, np.float32(0.1))

    p = points[:, mask]
    for k, way in enumerate(ways):
        reach = way @ p
        want = p[:, reach >= reach.max() - np.float32(0.1)].mean(axis=1, dtype=float)
        np.testing.assert_allclose(got[k], want, atol=1e-5)


def test_compiled_touches_and_tip_equal_plain_python():
    rng = np.random.default_rng(1)
    h, w = 12, 15
    label = np.zeros((h, w), np.int32)
    label[2:6, 3:9] = 1
    label[8:11, 2:4] = 2
    mask = (label == 0) & (rng.random((h, w)) < 0.6)
    depth = (mask * (0.5 + 0.1 * rng.random((h, w)))).astype(np.float32)
    measured = (0.5 + 0.1 * rng.random((h, w))).astype(np.float32)
    label[(label == 0) & (rng.random((h, w)) < 0.05)] = 3  # specks
    mask &= label == 0
    rays = rng.random((3, h, w)).astype(np.float32)
    start = rng.random(3).astype(np.float32)
    size = np.array([0, 24, 26, 5], np.int32)
    # Where nothing is measured the cloth's depth is a guess, and the thing's own counts.
    state = np.where(mask & (rng.random((h, w)) < 0.3), GROWN, 0).astype(np.uint8)
    depth[state == GROWN] += 0.2

    mask[:, :2] = mask[11:] = False

    got, boxes = touches(
        label, size, mask, depth, measured, state, rays, start, 0.05, (2, 2, 9, 11), (2, 0, w, 11)
    )

    want = np.zeros((4, 8))
    roi = np.zeros((h, w), bool)
    roi[2:11, 2:9] = True
    for y, x in np.argwhere((size[label] >= LEAST_AREA) & roi):
        n = label[y, x]
        want[n, 4] += 1
        want[n, 5:] += start + measured[y, x] * rays[:, y, x]
        for down, right in ((1, 0), (-1, 0), (0, 1), (0, -1)):
            way = [(y + n * down, x + n * right) for n in range(1, GAP + 2)]
            inside = [(j, i) for j, i in way if 0 <= j < h and 0 <= i < w]
            known = [(j, i) for j, i in inside if mask[j, i] or size[label[j, i]] >= LEAST_AREA]
            j, i = known[0] if known else (y, x)
            there = measured[y, x] if state[j, i] == GROWN else depth[j, i]
            if mask[j, i] and abs(there - measured[y, x]) < np.float32(0.05):
                want[n, 0] += 1
                want[n, 1:4] += start + there * rays[:, j, i]
    np.testing.assert_allclose(got, want, atol=1e-5)
    np.testing.assert_array_equal(boxes[1:3], [[3, 2, 9, 6], [2, 8, 4, 11]])

    away = np.array([0.3, -0.2, 0.1])
    p = (start[:, None, None] + measured * rays)[:, label == 1]
    along = away @ p / np.linalg.norm(away)
    end = p[:, along <= along.min() + 0.008].mean(axis=1)
    np.testing.assert_allclose(tip(label, 1, boxes[1], measured, rays, start, away), end, atol=1e-5)


def test_points_are_the_worlds(rig, sheet):
    area = foreground(sheet, View.of(sheet.camera, 1), rig.foreground, ForegroundOptions())
    middle = anchor(area)

    cloud = Cloud.of(area, middle)

    x0, y0, _, _ = cloud.box
    y, x = np.argwhere(cloud.mask)[1234]
    pixel = np.array([[x + x0, y + y0]], float)
    want = back_project(sheet.camera, pixel, area.depth[y + y0, x + x0].astype(float)[None])
    np.testing.assert_allclose(cloud.points[:, y, x] + middle, want[0], atol=1e-5)
