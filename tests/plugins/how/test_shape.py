from __future__ import annotations

import math

import numpy as np
import pytest
from clothrf_how.blocks import block_sums, blocks, blocks_names
from clothrf_how.border import border, border_names
from clothrf_how.cloud import Cloud, placed
from clothrf_how.contour import contour, contour_names, outline, rims, rims_down
from clothrf_how.extremes import directions, extremes, extremes_names, support_points
from clothrf_how.heightmap import CELLS, SIDE, binned, heightmap, heightmap_names
from clothrf_how.moments import moments, moments_names, raw_moments

GROUPS = [
    (blocks, blocks_names),
    (border, border_names),
    (contour, contour_names),
    (extremes, extremes_names),
    (heightmap, heightmap_names),
    (moments, moments_names),
]


@pytest.fixture(scope="module")
def cloud() -> Cloud:
    """An ellipse with holes, leaning over, in the upper left corner of a 320 x 240 picture."""
    rng = np.random.default_rng(0)
    h, w = 120, 160
    y, x = np.mgrid[:h, :w]
    mask = ((x - 70) / 75.0) ** 2 + ((y - 60) / 55.0) ** 2 < 1.0
    mask &= rng.random((h, w)) < 0.97
    points = np.stack([(60 - y) * 0.002, (x - 80) * 0.0015, (y - 50) * 0.001 + 0.01 * rng.random()])
    points = (points + 0.001 * rng.random(points.shape)) * mask
    rows, columns = np.flatnonzero(mask.any(1)), np.flatnonzero(mask.any(0))
    top, left = rows[0], columns[0]
    cut = (slice(top, rows[-1] + 1), slice(left, columns[-1] + 1))
    inside = np.ascontiguousarray(mask[cut])
    box = (0, 0, inside.shape[1], inside.shape[0])
    inner = np.ascontiguousarray(points[(slice(None), *cut)], dtype=np.float32)
    return Cloud(inner, inside, box, (240, 320))


@pytest.mark.parametrize(("values", "names"), GROUPS)
def test_every_group_gives_as_many_numbers_as_names(cloud, values, names):
    result = values(cloud)

    assert result.shape == (len(names()),)
    assert result.dtype == np.float32
    assert np.isfinite(result).all()
    assert len(set(names())) == len(names())


@pytest.mark.parametrize(("values", "names"), GROUPS)
def test_every_group_copes_with_a_single_pixel(values, names):
    one = Cloud(
        np.zeros((3, 1, 1), np.float32), np.ones((1, 1), bool), (319, 239, 320, 240), (240, 320)
    )

    result = values(one)

    assert result.shape == (len(names()),)
    assert np.isfinite(result).all()


def test_compiled_points_equal_numpy():
    rng = np.random.default_rng(1)
    depth = rng.random((6, 7)).astype(np.float32)
    mask = rng.random((6, 7)) < 0.5
    rays = rng.random((3, 6, 7)).astype(np.float32)
    start = rng.random(3).astype(np.float32)

    got = placed(depth, mask, rays, start, (0, 0, *mask.shape[::-1]))

    np.testing.assert_allclose(got, (start[:, None, None] + depth * rays) * mask, atol=1e-6)


def test_compiled_moments_equal_numpy(cloud):
    count, first, second, third = raw_moments(cloud.points, cloud.mask)

    p = cloud.points[:, cloud.mask].astype(float)
    assert count == p.shape[1]
    np.testing.assert_allclose(first, p.sum(axis=1), rtol=1e-5, atol=1e-4)
    np.testing.assert_allclose(second, p @ p.T, rtol=1e-5, atol=1e-4)
    want = np.einsum("in,jn,kn->ijk", p, p, p)
    for i, j, k in [(0, 0, 0), (0, 0, 1), (0, 1, 2), (1, 1, 2), (2, 2, 2)]:
        assert third[i, j, k] == pytest.approx(want[i, j, k], rel=1e-4, abs=1e-4)


def test_moments_are_central(cloud):
    shifted = Cloud(
        (cloud.points + np.float32(0.1)) * cloud.mask, cloud.mask, cloud.box, cloud.size
    )

    a, b = moments(cloud), moments(shifted)

    np.testing.assert_allclose(b[:3], a[:3] + 0.1, atol=1e-5)
    np.testing.assert_allclose(b[3:], a[3:], atol=2e-3)


def test_compiled_support_points_equal_numpy(cloud):
    got = support_points(cloud.points, cloud.mask, directions(), np.float32(3.0))

    y, x = np.nonzero(cloud.mask)
    for k, way in enumerate(directions()):
        reach = x * way[0] + y * way[1]
        near = reach >= reach.max() - np.float32(3.0)
        want = cloud.points[:, y[near], x[near]].mean(axis=1, dtype=float)
        np.testing.assert_allclose(got[k], want, atol=1e-6)


def test_a_corner_is_the_support_point_of_the_directions_around_it():
    h, w = 60, 80
    mask = np.ones((h, w), bool)
    y, x = np.mgrid[:h, :w]
    points = np.stack([x * 0.001, y * 0.001, 0.0 * x]).astype(np.float32)
    square = Cloud(points, mask, (10, 10, 90, 70), (240, 320))

    values = extremes(square).reshape(-1, 3)

    # Direction 2 of 16 points right and down by 45 degrees.
    assert math.hypot(values[2, 0] - 0.079, values[2, 1] - 0.059) < 3e-3


def test_compiled_rims_equal_numpy(cloud):
    mask = cloud.mask.copy()
    mask[3] = mask[:, 5] = False

    for got, seen in ((rims(mask), mask), (rims_down(mask), mask.T)):
        some = seen.any(axis=1)
        first = seen.argmax(axis=1)
        last = seen.shape[1] - 1 - seen[:, ::-1].argmax(axis=1)
        np.testing.assert_array_equal(got[0], np.where(some, first, -1))
        np.testing.assert_array_equal(got[1], np.where(some, last, -1))


def test_compiled_outline_equals_numpy(cloud):
    first, last = rims(cloud.mask)

    got = outline(cloud.points, first, last, 8)

    band = np.arange(len(first)) * 8 // len(first)
    for b in range(8):
        rows = np.flatnonzero(band == b)
        for side, column in enumerate((first, last)):
            want = cloud.points[:, rows, column[rows]].mean(axis=1, dtype=float)
            np.testing.assert_allclose(got[side, b], want, atol=1e-6)


def test_compiled_height_map_equals_numpy(cloud):
    height, share = binned(cloud.points, cloud.mask, CELLS, SIDE)

    x, y, z = cloud.points[:, cloud.mask]
    scale = np.float32(CELLS / SIDE)
    i = np.floor(x * scale + np.float32(CELLS / 2)).astype(int)
    j = np.floor(y * scale + np.float32(CELLS / 2)).astype(int)
    want = np.zeros((CELLS, CELLS))
    number = np.zeros((CELLS, CELLS))
    inside = (i >= 0) & (i < CELLS) & (j >= 0) & (j < CELLS)
    np.add.at(want, (i[inside], j[inside]), z[inside])
    np.add.at(number, (i[inside], j[inside]), 1.0)
    np.testing.assert_allclose(share, number / x.size, atol=1e-9)
    np.testing.assert_allclose(height, want / np.maximum(number, 1.0), atol=1e-6)


def test_compiled_block_sums_equal_numpy(cloud):
    got = block_sums(cloud.points, cloud.mask, 8)

    h, w = cloud.mask.shape
    y, x = np.nonzero(cloud.mask)
    want = np.zeros((4, 8, 8))
    for axis in range(3):
        np.add.at(want[axis], (y * 8 // h, x * 8 // w), cloud.points[axis, y, x])
    np.add.at(want[3], (y * 8 // h, x * 8 // w), 1.0)
    np.testing.assert_allclose(got, want, atol=1e-4)


def test_border_says_which_side_cuts_the_cloth_off(cloud):
    values = dict(zip(border_names(), border(cloud), strict=True))

    assert values["border_left_share"] > 0.0
    assert values["border_top_share"] > 0.0
    assert values["border_right_share"] == 0.0
    assert values["border_bottom_last_x"] == 0.0
    where = np.flatnonzero(cloud.mask[0])
    assert values["border_top_first_y"] == cloud.points[1, 0, where[0]]
    assert values["border_top_last_y"] == cloud.points[1, 0, where[-1]]
