"""What the shaders pack is unpacked; needs no graphics driver."""

from __future__ import annotations

import numpy as np
from clothrf_sapien.body import code_of, turned_to
from clothrf_sapien.camera import display
from clothrf_sapien.unpacking import unpack

from clothrf_core.scene import Label, SceneMesh, box, sphere


def test_the_kernel_equals_plain_numpy():
    rng = np.random.default_rng(3)
    packed = np.zeros((7, 9, 4), np.uint32)
    code = rng.choice([0, 1, 4, 129, 132], (7, 9)).astype(np.uint32)
    colour = rng.integers(0, 256, (7, 9, 3)).astype(np.uint32)
    z = rng.uniform(0.1, 2.0, (7, 9)).astype(np.float32)
    packed[..., 0] = colour[..., 0] | colour[..., 1] << 8 | colour[..., 2] << 16 | code << 24
    packed[..., 1] = z.view(np.uint32)
    background = np.array([7, 8, 9], np.uint8)
    rgb, depth = np.empty((7, 9, 3), np.uint8), np.empty((7, 9), np.float32)
    labels = np.empty((7, 9), np.uint8)

    unpack(packed, background, rgb, depth, labels)

    assert np.array_equal(labels, code % 128)
    assert np.array_equal(rgb, np.where((code > 0)[..., None], colour, background))
    measured = (code > 0) & (code < 128)
    assert np.array_equal(depth, np.where(measured, z, np.float32(np.nan)), equal_nan=True)


def test_a_code_says_label_and_whether_depth_is_measurable():
    ball = sphere(np.zeros(3), 0.1, Label.HAND, (1, 1, 1), segments=3)
    steel = SceneMesh(Label.GRIPPER, ball.vertices, ball.triangles, measurable=False)

    assert code_of(ball) == Label.HAND
    assert code_of(steel) == Label.GRIPPER + 128


def test_every_triangle_is_turned_to_the_eye_with_its_normals():
    cube = box(np.zeros(3), np.ones(3), Label.TABLE, (1, 1, 1))
    eye = np.array([3.0, -4.0, 5.0])

    vertices, normals, _ = turned_to(cube, eye)

    corners = vertices.reshape(-1, 3, 3).astype(float)
    front = np.cross(corners[:, 1] - corners[:, 0], corners[:, 2] - corners[:, 0])
    assert (np.einsum("mx,mx->m", front, eye - corners[:, 0]) > 0).all()
    assert (np.einsum("mkx,mx->mk", normals.reshape(-1, 3, 3), front) > 0.99).all()
    assert np.allclose(corners.mean(axis=1).mean(axis=0), 0.5)


def test_display_colour_has_gamma_2_2():
    assert display((0.0, 0.5, 1.0)).tolist() == [0, 186, 255]
