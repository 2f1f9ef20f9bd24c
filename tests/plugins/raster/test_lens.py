"""Distortion by resampling a pinhole picture."""

from __future__ import annotations

import cv2
import numpy as np
import pytest

from clothrf_core.errors import ShapeError
from clothrf_core.lens import Lens, LensCache
from clothrf_core.scene import Label, Picture
from clothrf_core.testing.camera import example_camera, plane_depth
from clothrf_core.types import RgbdFrame

BENT = np.array([0.12, -0.25, 0.002, -0.001, 0.08])


def pinhole_picture(lens, camera, depth, labels=None, rgb=None):
    pinhole = lens.pinhole(camera)
    shape = (pinhole.height, pinhole.width)
    frame = RgbdFrame(
        stamp_ns=1,
        rgb=np.zeros((*shape, 3), np.uint8) if rgb is None else rgb,
        depth=depth.astype(np.float32),
        camera=pinhole,
    )
    return Picture(frame, np.zeros(shape, np.uint8) if labels is None else labels)


def test_the_pinhole_picture_holds_every_ray_of_the_lens_and_little_more():
    camera = example_camera(distortion=BENT)
    lens = Lens.of(camera)

    points = cv2.undistortPoints(
        src=np.array([[[x, y]] for x in (0.0, 319.0) for y in (0.0, 239.0)]),
        cameraMatrix=camera.K,
        distCoeffs=camera.distortion,
        P=lens.K,
    )[:, 0]

    assert points.min() >= 0.0
    assert (points.max(axis=0) <= np.array(lens.size) - 2).all()
    assert np.prod(lens.size) < 1.25 * 320 * 240


def test_colour_agrees_with_opencv_remap():
    camera = example_camera(distortion=BENT)
    lens = Lens.of(camera)
    width, height = lens.size
    u, v = np.meshgrid(np.arange(width), np.arange(height))
    rgb = np.stack([u % 256, v % 256, (u + v) % 200], -1).astype(np.uint8)
    rgb = cv2.GaussianBlur(src=rgb, ksize=(0, 0), sigmaX=3.0)
    picture = pinhole_picture(lens, camera, np.ones((height, width)), rgb=rgb)

    bent = lens.bend(picture, camera).frame.rgb

    grid = np.stack(np.meshgrid(np.arange(320.0), np.arange(240.0)), -1).reshape(-1, 1, 2)
    place = (
        cv2.undistortPoints(src=grid, cameraMatrix=camera.K, distCoeffs=camera.distortion, P=lens.K)
        .reshape(240, 320, 2)
        .astype(np.float32)
    )
    expected = cv2.remap(
        src=rgb, map1=place[..., 0], map2=place[..., 1], interpolation=cv2.INTER_LINEAR
    )
    assert np.abs(bent.astype(int) - expected.astype(int)).max() <= 3


def test_depth_at_an_edge_is_that_of_one_side_never_between():
    camera = example_camera(distortion=BENT)
    lens = Lens.of(camera)
    width, height = lens.size
    depth = np.where(np.arange(width) < width // 2, 0.8, 1.1) * np.ones((height, 1))

    seen = lens.bend(pinhole_picture(lens, camera, depth), camera).frame.depth

    assert set(np.unique(seen).tolist()) <= {np.float32(0.8), np.float32(1.1)} or (
        np.minimum(np.abs(seen - 0.8), np.abs(seen - 1.1)).max() < 1e-6
    )


def test_a_plane_at_a_grazing_angle_is_interpolated():
    camera = example_camera(distortion=BENT)
    lens = Lens.of(camera)
    corners = np.array([[-3, 0.1, 0.2], [3, 0.1, 0.2], [3, 0.3, 2.5], [-3, 0.3, 2.5]], float)
    truth = plane_depth(camera, corners)
    straight = plane_depth(lens.pinhole(camera), corners)

    seen = lens.bend(pinhole_picture(lens, camera, straight), camera).frame.depth

    near = (truth > 0.1) & (truth < 3.0)
    assert np.abs(seen - truth)[near].max() < 2e-3
    assert np.abs(seen - truth)[near & (truth < 1.0)].max() < 2e-4


def test_holes_stay_holes_and_do_not_grow():
    camera = example_camera(distortion=BENT)
    lens = Lens.of(camera)
    width, height = lens.size
    depth = np.full((height, width), 0.9)
    depth[60:90, 100:150] = np.nan

    seen = lens.bend(pinhole_picture(lens, camera, depth), camera).frame.depth

    assert 0.9 * 1500 < np.isnan(seen).sum() < 1.1 * 1500
    assert np.allclose(seen[np.isfinite(seen)], 0.9, atol=1e-6)


def test_labels_are_those_of_the_nearest_pixel():
    camera = example_camera(distortion=BENT)
    lens = Lens.of(camera)
    width, height = lens.size
    labels = np.zeros((height, width), np.uint8)
    labels[:, ::2] = Label.CLOTH

    seen = lens.bend(pinhole_picture(lens, camera, np.ones((height, width)), labels), camera)

    assert set(np.unique(seen.labels)) == {0, Label.CLOTH}


def test_a_camera_that_moves_keeps_its_lens():
    cache = LensCache()
    camera = example_camera(distortion=BENT)
    moved = example_camera(distortion=BENT.copy())
    other = example_camera(distortion=2.0 * BENT)

    assert cache.of(camera) is cache.of(moved)
    assert cache.of(other) is not cache.of(camera)


def test_a_distortion_that_cannot_be_undone_is_refused():
    camera = example_camera(distortion=np.array([-2.5, 0.0, 0.0, 0.0]))

    with pytest.raises(ShapeError, match="expected coefficients that can be undone"):
        Lens.of(camera)
