"""The sensors' errors, measured, against the formulas they are built from."""

from __future__ import annotations

import dataclasses

import numpy as np
import pytest
from clothrf_randomize.config import SensorNoise
from clothrf_randomize.families import axial_sensor
from clothrf_randomize.sensor import Sensor

OFF = dict.fromkeys(("jitter", "axial", "smooth", "incidence", "edges", "holes", "offset"), 0.0)
FAMILIES = ["sr300", "d435", "kinect", "disparity", "stereo"]


def sensor(family="sr300", **parts):
    options = OFF | {"quantise": False, "episode": "fixed"} | parts
    return Sensor(SensorNoise(family=family, **options))


def seen(frame, made, count=40, seed=0):
    rng = np.random.default_rng(seed)
    numbers = made.draw(rng)
    return np.stack([made.apply(frame, numbers, rng).depth for _ in range(count)])


def inner(stack):
    return stack[:, 150:330, 200:440]


@pytest.mark.parametrize(
    ("family", "z", "sigma"),
    [
        ("sr300", 0.5, 1.3e-3 * 0.25),
        ("sr300", 1.0, 1.3e-3),
        ("kinect", 0.5, 0.0012 + 0.0019 * 0.01),
        ("kinect", 1.4, 0.0012 + 0.0019),
        ("d435", 0.5, 0.001063 + 0.0007278 * 0.5 + 0.003949 * 0.25),
    ],
)
@pytest.mark.parametrize("strength", [0.5, 1.0, 3.0])
def test_axial_noise_has_the_published_sigma(flat, family, z, sigma, strength):
    frame = dataclasses.replace(flat, depth=flat.depth * np.float32(z / 0.5))
    stack = inner(seen(frame, sensor(family, axial=strength)))
    assert stack.std() == pytest.approx(strength * sigma, rel=0.02)
    assert stack.mean() == pytest.approx(z, abs=0.01 * sigma * strength)


def test_smooth_noise_is_as_large_as_axial_noise_and_shared_by_neighbours(flat):
    stack = inner(seen(flat, sensor(smooth=1.0), count=150))[:, ::20, ::20]
    assert stack.std() == pytest.approx(1.3e-3 * 0.25, rel=0.1)
    error = stack - 0.5
    assert np.corrcoef(error[:, 0, 0], error[:, 1, 0])[0, 1] > 0.85


@pytest.mark.parametrize("degrees", [0.0, 30.0, 50.0, 65.0])
@pytest.mark.parametrize("family", ["sr300", "kinect", "d435"])
def test_noise_grows_with_incidence_as_published(flat, family, degrees):
    # A plate turned about the camera's y axis; beside the axis the incidence changes by < 5 deg.
    _, u = np.mgrid[0:480, 0:640]
    ray = (u - 319.5) / 620.0
    z = 0.6 / (1.0 - np.tan(np.radians(degrees)) * ray)
    depth = np.where((z > 0.3) & (z < 1.2), z, np.nan).astype(np.float32)
    frame = dataclasses.replace(flat, depth=depth)

    stack = seen(frame, sensor(family, axial=1.0, incidence=1.0), count=60)

    patch = stack[:, 225:255, 314:326]
    error = patch - z[225:255, 314:326]
    expected = axial_sensor(family).sigma(np.array(0.6), np.radians(degrees))
    assert np.nanstd(error) == pytest.approx(float(expected), rel=0.06)
    assert not np.isnan(patch).any()
    if family == "kinect":
        stack = seen(frame, sensor(family, incidence=1.0, cosine_drop=True), count=60)
        lost = 1.0 - np.cos(np.radians(degrees))
        assert np.isnan(stack[:, 225:255, 314:326]).mean() == pytest.approx(lost, abs=0.02)


def test_steep_surfaces_lose_depth_beyond_70_degrees(flat):
    _, u = np.mgrid[0:480, 0:640]
    shares = []
    for degrees in (60.0, 78.0, 85.0):
        z = 0.6 / (1.0 - np.tan(np.radians(degrees)) * (u - 319.5) / 620.0)
        depth = np.where((z > 0.5) & (z < 0.72), z, np.nan).astype(np.float32)
        stack = seen(dataclasses.replace(flat, depth=depth), sensor(incidence=1.0))
        shares.append(np.isnan(stack[:, :, 318:322]).mean())
    assert shares[0] == 0.0
    assert shares[1] == pytest.approx(0.4, abs=0.08)
    assert shares[2] == pytest.approx(0.75, abs=0.1)


def test_drop_outs_near_edges_are_the_measured_table(flat):
    stack = seen(flat, sensor(edges=1.0), count=300)
    lost = np.isnan(stack[:, 200:280, 120:160]).mean(axis=(0, 1))
    expected = {0: 0.37, 1: 0.105, 2: 0.042, 3: 0.042, 4: 0.013, 7: 0.013, 8: 0.005, 20: 0.0003}
    for pixels, share in expected.items():
        # 24,000 trials a column; four standard deviations.
        tolerance = 4 * np.sqrt(share * (1 - share) / 24000)
        assert lost[pixels] == pytest.approx(share, abs=tolerance), f"{pixels} px from the edge"


def test_twice_the_strength_drops_twice_as_much(flat):
    one, two = (np.isnan(seen(flat, sensor(edges=s))[:, 200:280, 121]).mean() for s in (1.0, 2.0))
    assert two / one == pytest.approx(2.0, rel=0.15)


def test_depth_is_a_whole_number_of_counts(flat):
    for family, unit in (("sr300", 0.125e-3), ("kinect", 1e-3), ("d435", 1e-3)):
        stack = inner(seen(flat, sensor(family, axial=1.0, quantise=True), count=4))
        counts = stack.astype(float) / unit
        np.testing.assert_allclose(counts, np.rint(counts), atol=2e-3)
        assert len(np.unique(np.rint(counts))) > 3


def test_disparities_are_rounded_to_their_step(flat):
    for family, fb, step in (("disparity", 351.30 / 8, 1 / 8), ("stereo", 620 * 0.05, 1 / 32)):
        stack = inner(seen(flat, sensor(family, axial=1.0), count=4))
        steps = fb / stack[np.isfinite(stack)].astype(float) / step
        np.testing.assert_allclose(steps, np.rint(steps), atol=2e-3)


def test_stereo_noise_follows_the_square_of_the_depth(flat):
    for z in (0.5, 1.0):
        frame = dataclasses.replace(flat, depth=flat.depth * np.float32(z / 0.5))
        stack = inner(seen(frame, sensor("stereo", axial=1.0)))
        # sigma_z = z^2 s / (f B), and uniform rounding of 1/32 px.
        sigma = z**2 * np.hypot(0.08, 1 / 32 / np.sqrt(12)) / (620 * 0.05)
        assert np.nanstd(stack) == pytest.approx(sigma, rel=0.04)


def test_stereo_loses_the_shadow_beside_a_near_object(flat):
    depth = np.full((480, 640), 1.0, np.float32)
    depth[200:300, 300:400] = 0.5
    stack = seen(dataclasses.replace(flat, depth=depth), sensor("stereo", axial=1e-3), count=1)
    lost = np.isnan(stack[0, 250])
    # Width of the shadow: f B (1 / 0.5 - 1 / 1.0) = 31 px, left of the object.
    assert lost[300 - 31 : 300].all()
    assert not lost[300:400].any()
    assert not lost[400:].any()
    assert lost[:30].all()  # the second camera does not see this border


def test_the_dot_window_drops_thin_and_steep_things(flat):
    depth = np.array(flat.depth)
    depth[:, 300:303] -= 0.1
    stack = seen(dataclasses.replace(flat, depth=depth), sensor("disparity", axial=1.0), count=5)
    assert np.isnan(stack[:, 150:330, 301]).all()
    assert np.isfinite(stack[:, 150:330, 320:500]).all()
    assert np.isnan(stack[:, 200:280, 121]).all()  # a window that half hangs over the border


def test_the_dot_window_keeps_slopes_of_a_cloth_on_a_table(flat):
    u = np.mgrid[0:480, 0:640][1]
    shares = []
    for degrees in (30.0, 50.0, 80.0):
        z = 0.5 / (1.0 - np.tan(np.radians(degrees)) * (u - 319.5) / 620.0)
        depth = np.where((z > 0.4) & (z < 0.6), z, np.nan).astype(np.float32)
        stack = seen(dataclasses.replace(flat, depth=depth), sensor("disparity", axial=1.0), 2)
        shares.append(np.isfinite(stack[:, 100:380, 316:324]).mean())
    assert shares[0] == 1.0
    assert shares[1] > 0.98
    assert shares[2] < 0.02


def test_jitter_moves_edges_and_nothing_else(flat):
    stack = seen(flat, sensor(jitter=1.0), count=200)
    # P(a pixel k beyond the edge is covered) = P(N(0, 0.5) > k - 0.5 px).
    covered = np.isfinite(stack[:, 200:280, 110:130]).mean(axis=(0, 1))
    assert covered[9] == pytest.approx(0.1587, abs=0.02)
    assert covered[10] == pytest.approx(1 - 0.1587, abs=0.02)
    assert covered[8] == pytest.approx(0.00135, abs=0.002)
    assert np.array_equal(
        inner(stack), np.broadcast_to(inner(flat.depth[None]), inner(stack).shape)
    )


def test_holes_are_blobs_of_at_most_40_pixels(flat):
    stack = seen(flat, sensor(holes=1.0), count=100)
    lost = np.isnan(stack) & np.isfinite(flat.depth)
    counts = lost.sum(axis=(1, 2))
    assert (counts == 0).mean() == pytest.approx(0.25, abs=0.15)
    assert counts.max() <= 3 * np.pi * 20**2 * 1.05
    assert counts.max() > 200
    rows = lost.any(axis=2).sum(axis=1)
    assert rows.max() <= 3 * 42


def test_bias_and_scale_last_for_a_roll_out(flat):
    made = Sensor(SensorNoise(**OFF | {"offset": 1.0}, quantise=False))
    drawn = [made.draw(np.random.default_rng(i)) for i in range(400)]
    assert np.std([d["bias"] for d in drawn]) == pytest.approx(0.002, rel=0.1)
    assert np.std([d["scale"] for d in drawn]) == pytest.approx(0.005, rel=0.1)
    rng = np.random.default_rng(0)
    frames = [made.apply(flat, drawn[0], rng).depth for _ in range(2)]
    assert np.array_equal(frames[0], frames[1], equal_nan=True)
    expected = 0.5 * (1 + drawn[0]["scale"]) + drawn[0]["bias"]
    np.testing.assert_allclose(frames[0][240, 320], expected, atol=1e-6)


def test_uniform_strengths_average_to_the_chosen_one():
    made = Sensor(SensorNoise(strength=1.5, episode="uniform"))
    drawn = [made.draw(np.random.default_rng(i)) for i in range(500)]
    for part in ("jitter", "axial", "smooth", "incidence", "edges", "holes"):
        values = [d[part] for d in drawn]
        assert np.mean(values) == pytest.approx(1.5, abs=0.12)
        assert max(values) <= 3.0


@pytest.mark.parametrize("family", FAMILIES)
def test_full_noise_leaves_most_of_the_picture_and_touches_all_of_it(flat, family):
    made = Sensor(SensorNoise(family=family, episode="fixed"))
    rng = np.random.default_rng(0)
    depth = made.apply(flat, made.draw(rng), rng).depth
    patch = depth[150:330, 200:440]
    assert np.isfinite(patch).mean() > 0.8
    assert np.nanstd(patch) > 1e-4
    assert abs(np.nanmean(patch) - 0.5) < 0.02
    assert np.isnan(depth[:60]).all()


@pytest.mark.parametrize("family", FAMILIES)
def test_a_picture_without_depth_stays_without(flat, family):
    empty = dataclasses.replace(flat, depth=np.full((480, 640), np.nan, np.float32))
    made = Sensor(SensorNoise(family=family, episode="fixed"))
    rng = np.random.default_rng(0)
    assert np.isnan(made.apply(empty, made.draw(rng), rng).depth).all()


@pytest.mark.parametrize("family", FAMILIES)
def test_a_single_measured_pixel_in_the_corner_is_no_trouble(flat, family):
    depth = np.full((480, 640), np.nan, np.float32)
    depth[0, 639] = 0.4
    made = Sensor(SensorNoise(family=family, episode="fixed"))
    rng = np.random.default_rng(0)
    out = made.apply(dataclasses.replace(flat, depth=depth), made.draw(rng), rng).depth
    assert np.isnan(out[20:, :600]).all()
