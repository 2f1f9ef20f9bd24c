import cv2
import numpy as np
import pytest

from clothrf_core.camera_model import (
    back_project,
    clip_range,
    cropped,
    distort,
    project,
    rays,
    scaled,
    undistort,
)
from clothrf_core.geometry import inverse, look_at
from clothrf_core.types import CameraModel

K = np.array([[610.0, 0.0, 331.0], [0.0, 605.0, 222.0], [0.0, 0.0, 1.0]])
LENSES = [
    np.zeros(0),
    np.array([0.1, -0.05, 0.001, -0.002]),
    np.array([-0.28, 0.08, 0.001, -0.0005, 0.01]),
    np.array([0.2, 0.1, 0.001, -0.001, 0.02, 0.15, 0.05, 0.01]),
]


def camera(lens=None):
    T = look_at(np.array([0.8, 0.1, 0.6]), np.array([0.3, 0.0, 0.2]))
    return CameraModel(640, 480, K, T, distortion=LENSES[0] if lens is None else lens)


@pytest.mark.parametrize("lens", LENSES, ids=len)
def test_projection_equals_opencv(lens, rng):
    model = camera(lens)
    points = rng.uniform([0.2, -0.2, 0.0], [0.5, 0.2, 0.3], (50, 3))
    T = inverse(model.T_world_camera)
    wanted, _ = cv2.projectPoints(
        objectPoints=points,
        rvec=cv2.Rodrigues(src=T[:3, :3])[0],
        tvec=T[:3, 3],
        cameraMatrix=K,
        distCoeffs=lens if lens.size else None,
    )
    assert np.abs(project(model, points)[0] - wanted.reshape(-1, 2)).max() < 1e-9


@pytest.mark.parametrize("lens", LENSES, ids=len)
def test_back_projection_inverts_projection(lens, rng):
    model = camera(lens)
    points = rng.uniform([0.2, -0.15, 0.0], [0.5, 0.15, 0.3], (50, 3))
    pixels, depth = project(model, points)
    assert np.abs(back_project(model, pixels, depth) - points).max() < 1e-9


def test_a_point_behind_the_camera_has_no_pixel():
    model = camera()
    behind = model.T_world_camera[:3, 3] - model.T_world_camera[:3, 2]
    pixels, depth = project(model, behind[None])
    assert np.isnan(pixels).all()
    assert depth[0] < 0


def test_undistortion_inverts_distortion(rng):
    xy = rng.uniform(-0.4, 0.4, (100, 2))
    for lens in LENSES:
        assert np.abs(undistort(lens, distort(lens, xy)) - xy).max() < 1e-9


def test_a_cropped_camera_sees_the_same_point_shifted(rng):
    point = rng.uniform([0.25, -0.1, 0.1], [0.4, 0.1, 0.2], (1, 3))
    pixels, _ = project(camera(), point)
    part, _ = project(cropped(camera(), 40, 30, 300, 200), point)
    assert np.allclose(part, pixels - [40, 30])


def test_scaling_keeps_the_outer_border_of_the_picture_in_place():
    half = scaled(camera(), 0.5)
    corner = np.array([[-0.5, -0.5]])
    full = back_project(camera(), corner, np.ones(1))
    assert np.allclose(project(half, full)[0], corner)
    assert (half.width, half.height) == (320, 240)


def test_the_clip_range_holds_the_whole_workspace():
    low, high = np.array([0.1, -0.3, 0.0]), np.array([0.7, 0.3, 0.5])
    near, far = clip_range(camera(), low, high)
    corners = np.array(np.meshgrid(*zip(low, high, strict=True))).reshape(3, -1).T
    z = project(camera(), corners)[1]
    assert near <= z.min()
    assert z.max() <= far


def test_a_ray_times_depth_is_the_back_projected_point():
    model = camera(LENSES[2])
    ray = rays(model)[100, 200].astype(float)
    local = np.array([*(0.7 * ray), 0.7, 1.0])
    wanted = back_project(model, np.array([[200.0, 100.0]]), np.array([0.7]))[0]
    assert np.abs((model.T_world_camera @ local)[:3] - wanted).max() < 1e-6
