"""What the pictures must look like, against numbers computed another way."""

from __future__ import annotations

import cv2
import matplotlib.path
import numpy as np
import pytest
from clothrf_raster.camera import RasterCamera
from clothrf_raster.config import RasterConfig

from clothrf_core.scene import Label, Light, Scene, SceneMesh, box, sphere
from clothrf_core.testing.camera import example_camera, plane_depth, quad
from clothrf_core.types import CameraModel

STRAIGHT = CameraModel(
    width=64,
    height=48,
    K=np.array([[60.0, 0.0, 31.0], [0.0, 60.0, 23.0], [0.0, 0.0, 1.0]]),
    T_world_camera=np.eye(4),
    near=0.1,
    far=4.0,
)


def render(scene, camera=STRAIGHT, **options):
    return RasterCamera(RasterConfig(**options)).render(scene, camera)


def flat(points, label=Label.CLOTH, colour=(0.8, 0.8, 0.8)):
    points = np.array(points, float)
    triangles = np.arange(len(points), dtype=np.int32).reshape(-1, 3)
    return SceneMesh(label, points, triangles, colour)


def test_depth_of_a_tilted_plane_is_exact_to_a_hundredth_of_a_millimetre():
    camera = example_camera(factor=2.0)
    corners = np.array([[-2, -2, 0.5], [2, -2, 0.9], [2, 2, 1.4], [-2, 2, 1.0]], float)

    depth = render(Scene(meshes=(quad(camera, corners),)), camera).frame.depth

    assert np.abs(depth - plane_depth(camera, corners)).max() < 3e-6


@pytest.mark.parametrize("bent", [(), (0.12, -0.25, 0.002, -0.001, 0.08), (-0.3, 0.1, 0.0, 0.0)])
def test_a_triangle_covers_what_opencv_projects_it_to(bent):
    camera = example_camera(distortion=np.array(bent, float), factor=2.0)
    T_cw = np.linalg.inv(camera.T_world_camera)
    rng = np.random.default_rng(5)
    t = np.linspace(0.0, 1.0, 101)[:-1, None]
    v, u = np.mgrid[0:480, 0:640]
    for _ in range(5):
        local = np.append(rng.uniform(-0.35, 0.35, (3, 2)), np.ones((3, 1)), axis=1)
        local *= rng.uniform(0.5, 1.5, (3, 1))
        world = local @ camera.T_world_camera[:3, :3].T + camera.T_world_camera[:3, 3]
        edges = [a + t * (b - a) for a, b in zip(world, np.roll(world, -1, 0), strict=True)]
        outline, _ = cv2.projectPoints(
            objectPoints=np.concatenate(edges),
            rvec=cv2.Rodrigues(src=T_cw[:3, :3])[0],
            tvec=T_cw[:3, 3],
            cameraMatrix=camera.K,
            distCoeffs=camera.distortion if bent else None,
        )
        mesh = SceneMesh(Label.CLOTH, world, np.array([[0, 1, 2]], np.int32))

        drawn = render(Scene(meshes=(mesh,)), camera, colour=False).labels > 0

        path = matplotlib.path.Path(outline[:, 0])
        inside = path.contains_points(np.stack([u.ravel(), v.ravel()], 1)).reshape(480, 640)
        wrong = np.argwhere(inside != drawn)[:, ::-1].astype(np.float32)
        polygon = outline.astype(np.float32)
        off = [
            abs(cv2.pointPolygonTest(contour=polygon, pt=p.tolist(), measureDist=True))
            for p in wrong
        ]
        assert drawn.sum() > 100
        assert max(off, default=0.0) <= 0.1


def test_a_pixel_on_a_shared_edge_is_drawn_exactly_once():
    u = np.linspace(-0.4, 0.4, 9)
    grid = np.stack(np.meshgrid(u, u, indexing="ij"), -1).reshape(-1, 2)
    points = np.concatenate([grid, np.ones((81, 1))], axis=1)
    i, j = np.meshgrid(np.arange(8), np.arange(8), indexing="ij")
    a = (9 * i + j).ravel()
    triangles = np.concatenate(
        [np.stack([a, a + 1, a + 9], 1), np.stack([a + 1, a + 10, a + 9], 1)]
    )
    counts = np.zeros((48, 64), int)
    for one in triangles.astype(np.int32):
        mesh = SceneMesh(Label.CLOTH, points, one[None])
        counts += render(Scene(meshes=(mesh,)), colour=False).labels > 0

    # Pixel centres x = 31 + 60 * [-0.4, 0.4) = 7 .. 54, y = 23 + ... = -1 .. 46, half open.
    assert counts.max() == 1
    assert np.argwhere(counts).min(axis=0).tolist() == [0, 7]
    assert np.argwhere(counts).max(axis=0).tolist() == [46, 54]
    assert counts.sum() == 47 * 48


def test_a_folded_sheet_seen_from_far_has_no_cracks():
    rng = np.random.default_rng(2)
    u, v = np.meshgrid(np.linspace(-1, 1, 60), np.linspace(-1, 1, 60), indexing="ij")
    z = 1.5 + 0.1 * np.sin(9 * u) * np.cos(7 * v) + 0.01 * rng.normal(size=u.shape)
    i, j = np.meshgrid(np.arange(59), np.arange(59), indexing="ij")
    a = (60 * i + j).ravel()
    triangles = np.concatenate(
        [np.stack([a, a + 1, a + 60], 1), np.stack([a + 1, a + 61, a + 60], 1)]
    )
    mesh = SceneMesh(
        Label.CLOTH, np.stack([u, v, z], -1).reshape(-1, 3), triangles.astype(np.int32)
    )

    labels = render(Scene(meshes=(mesh,)), colour=False).labels

    assert (labels == Label.CLOTH).all()


def test_slivers_seen_edge_on_stay_within_their_depth_range():
    mesh = flat(
        [[0, 0, 1], [1e-7, 0.3, 2], [0, -0.3, 1.5], [0.1, 0, 1], [0.1, 1e-9, 2], [0.3, 0, 3]]
    )

    depth = render(Scene(meshes=(mesh,)), colour=False).frame.depth

    seen = depth[np.isfinite(depth)]
    assert seen.size == 0 or (seen.min() >= 1.0 - 1e-5 and seen.max() <= 3.0 + 1e-5)


def test_vertices_that_are_not_finite_draw_nothing():
    mesh = flat([[0, 0, 1], [0.1, np.nan, 1], [0.1, 0.1, 1], [0, 0, np.inf], [1, 0, 1], [0, 1, 1]])

    assert not render(Scene(meshes=(mesh,))).labels.any()


def test_the_brightness_follows_lamberts_law():
    light = Light(direction=(0.0, 0.6, 0.8), intensity=0.5, ambient=0.2)
    wall = flat([[-9, -9, 2], [9, -9, 2], [9, 9, 2], [-9, -9, 2], [9, 9, 2], [-9, 9, 2]])

    rgb = render(Scene(meshes=(wall,), light=light)).frame.rgb

    expected = 255.0 * (0.8 * (0.2 + 0.5 * 0.8)) ** (1.0 / 2.2)
    assert np.abs(rgb.astype(float) - expected).max() <= 1.0


def test_the_side_away_from_the_light_gets_the_ambient_light_only():
    light = Light(direction=(0.0, 0.0, -1.0), intensity=0.5, ambient=0.2)
    wall = flat([[-9, -9, 2], [9, -9, 2], [9, 9, 2], [-9, -9, 2], [9, 9, 2], [-9, 9, 2]])

    rgb = render(Scene(meshes=(wall,), light=light)).frame.rgb

    assert np.abs(rgb.astype(float) - 255.0 * (0.8 * 0.2) ** (1.0 / 2.2)).max() <= 1.0


def test_a_sphere_is_shaded_smoothly_and_a_box_keeps_its_edges():
    light = Light(direction=(0.6, 0.0, 0.8), intensity=0.9, ambient=0.1)
    ball = sphere(np.array([0, 0, 1.0]), 0.3, Label.HAND, (1.0, 1.0, 1.0))
    cube = box(np.array([-0.2, -0.9, 0.9]), np.array([0.2, 0.9, 1.3]), Label.TABLE, (1, 1, 1))
    turn = np.array([[0.8, 0, 0.6], [0, 1, 0], [-0.6, 0, 0.8]])
    centre = np.array([0, 0, 1.1])
    cube = SceneMesh(
        cube.label, (cube.vertices - centre) @ turn + centre, cube.triangles, (1, 1, 1)
    )

    round_row = render(Scene(meshes=(ball,), light=light)).frame.rgb[23, 20:43, 0].astype(int)
    picture = render(Scene(meshes=(cube,), light=light))
    cube_row = picture.frame.rgb[23][picture.labels[23] == Label.TABLE][:, 0]

    assert np.abs(np.diff(round_row)).max() < 25
    assert len(np.unique(cube_row)) == 2


def test_without_colour_the_picture_is_black_and_the_rest_is_the_same():
    scene = Scene(meshes=(sphere(np.array([0, 0, 1.0]), 0.3, Label.HAND, (1, 1, 1)),))

    shaded, plain = render(scene), render(scene, colour=False)

    assert not plain.frame.rgb.any()
    assert shaded.frame.rgb.max() > 100
    assert np.array_equal(shaded.labels, plain.labels)
    assert np.array_equal(shaded.frame.depth, plain.frame.depth, equal_nan=True)
