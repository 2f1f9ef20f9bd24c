"""Every kernel equals its plain numpy twin."""

from __future__ import annotations

import dataclasses
import importlib.util
from pathlib import Path

import numpy as np
import pytest
from clothrf_randomize.axial import AxialStrengths, Lens, axial_noise
from clothrf_randomize.disparity import DisparityStrengths, disparity_noise, dot_pattern
from clothrf_randomize.edges import Window, edge_distance2, measured_window
from clothrf_randomize.families import EDGE_DROP, axial_sensor, disparity_sensor
from clothrf_randomize.pool import make_pool, starts
from clothrf_randomize.sensor import JUMP
from clothrf_randomize.smooth import field, weights

spec = importlib.util.spec_from_file_location("twins", Path(__file__).with_name("twins.py"))
twins = importlib.util.module_from_spec(spec)
spec.loader.exec_module(twins)

POOL = make_pool()
DROP = np.array(EDGE_DROP, np.float32)


def parts(frame, nodes_shape=(8, 8), margin=4):
    window = Window(*measured_window(frame.depth, margin))
    near2 = edge_distance2(frame.depth, window, jump=JUMP)
    rng = np.random.default_rng(4)
    rows = starts(rng, frame.depth.shape[0])
    nodes = rng.standard_normal(nodes_shape, dtype=np.float32)
    height, width = frame.depth.shape
    grid = (weights(height, nodes_shape[0]), weights(width, nodes_shape[1]))
    return window, near2, rows, nodes, grid


def assert_same_picture(found, expected, atol):
    np.testing.assert_array_equal(np.isnan(found), np.isnan(expected))
    np.testing.assert_allclose(found, expected, rtol=0, atol=atol)


def test_the_window_holds_all_measured_pixels(small):
    rows, columns = np.nonzero(np.isfinite(small.depth))
    assert measured_window(small.depth, 0) == (12, rows.max() + 1, 0, columns.max() + 1)
    assert measured_window(small.depth, 3) == (9, 60, 0, 81)
    assert measured_window(np.full((5, 5), np.nan, np.float32), 3) == (0, 0, 0, 0)


def test_edge_distance_is_the_euclidean_one(small):
    window = Window(*measured_window(small.depth, 4))
    found = edge_distance2(small.depth, window, jump=JUMP)
    np.testing.assert_array_equal(found, twins.edge_distance2(small.depth, window, JUMP))
    assert (found == 0).any()
    assert (found > 100).any()


@pytest.mark.parametrize("family", ["sr300", "kinect", "d435"])
@pytest.mark.parametrize(
    "strengths",
    [
        AxialStrengths(0.5, 1.0, 1.0, 1.0, 0.125e-3, 0.002, -0.003),
        AxialStrengths(0.0, 2.0, 0.0, 0.0, 0.0, 0.0, 0.0),
        AxialStrengths(2.0, 0.0, 1.5, 3.0, 1e-3, -0.001, 0.01),
    ],
)
def test_axial_noise_equals_its_twin(small, family, strengths):
    window, near2, rows, nodes, grid = parts(small, margin=8)
    lens = Lens(90.0, 95.0, 41.0, 30.0)
    sensor = axial_sensor(family)
    found = axial_noise(
        small.depth, window, near2, lens, sensor, strengths, edge_drop=DROP, pool=POOL,
        starts=rows, nodes=nodes, grid=grid, jump=JUMP,
    )  # fmt: skip
    with np.errstate(invalid="ignore"):
        expected = twins.axial(
            small.depth, window, near2, lens, sensor, strengths, drop=DROP, pool=POOL,
            starts=rows, nodes=nodes, grid=grid, jump=JUMP,
        )  # fmt: skip
    # Rounding of single precision may choose the other count.
    different = ~np.isclose(found, expected, rtol=0, atol=2e-6, equal_nan=True)
    assert different.mean() < 0.002
    assert_same_picture(found, expected, max(strengths.unit * 1.01, 2e-6))
    assert np.nanstd(found - small.depth) > 1e-4


@pytest.mark.parametrize("family", ["disparity", "stereo"])
@pytest.mark.parametrize(
    "strengths",
    [DisparityStrengths(0.5, 1.0, 0.002, -0.003), DisparityStrengths(0.0, 0.5, 0.0, 0.0)],
)
def test_disparity_noise_equals_its_twin(small, family, strengths):
    sensor = disparity_sensor(family)
    if sensor.window:  # at 90 px of focal length the sheet would be too steep to be matched
        depth = (0.5 + 0.08 * (small.depth - 0.5)).astype(np.float32)
        small = dataclasses.replace(small, depth=depth)
    shape = (60 // 4 + 2, 84 // 4 + 2) if sensor.cell_px else (8, 8)
    window, near2, rows, nodes, grid = parts(small, shape)
    dots = dot_pattern()
    found = disparity_noise(
        small.depth, window, near2, 90.0, sensor, strengths, edge_drop=DROP, dots=dots, pool=POOL,
        starts=rows, nodes=nodes, grid=grid,
    )  # fmt: skip
    with np.errstate(invalid="ignore"):
        expected = twins.disparity(
            small.depth, window, near2, 90.0, sensor, strengths, drop=DROP, dots=dots, pool=POOL,
            starts=rows, nodes=nodes, grid=grid,
        )  # fmt: skip
    different = ~np.isclose(found, expected, rtol=0, atol=2e-6, equal_nan=True)
    assert different.mean() < 0.002
    fb = sensor.focal_baseline or 90.0 * sensor.baseline
    assert_same_picture(found, expected, 0.6**2 / fb * sensor.step_px * strengths.noise * 1.1)
    assert 0.2 < np.isfinite(found).mean() < 0.95


def test_smooth_noise_has_unit_variance_at_every_pixel():
    rows, columns = weights(40, 5), weights(60, 7)
    rng = np.random.default_rng(0)
    fields = [field(rng.standard_normal((5, 7)), rows, columns) for _ in range(1500)]
    np.testing.assert_allclose(np.var(fields, axis=0), 1.0, atol=0.2)
    assert np.corrcoef([f[20, 30] for f in fields], [f[20, 32] for f in fields])[0, 1] > 0.9
    assert abs(np.corrcoef([f[5, 5] for f in fields], [f[35, 55] for f in fields])[0, 1]) < 0.1


def test_the_pool_is_standard_normal_and_uniform():
    normal, uniform = POOL.normal[: 1 << 18], POOL.uniform[: 1 << 18]
    assert normal.std() == pytest.approx(1.0, abs=1e-5)
    assert np.mean(normal**4) == pytest.approx(3.0, abs=0.05)
    assert np.mean(uniform) == pytest.approx(0.5, abs=0.005)
    assert uniform.max() < 1.0
