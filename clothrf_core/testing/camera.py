"""The contract of a rendered camera: geometry, holes, determinism, agreement with OpenCV's lens.

def test_my_camera():
check_rendered_camera(lambda: MyCamera(...))
"""

from __future__ import annotations

import dataclasses
from collections.abc import Callable, Iterator

import numpy as np
from numpy.typing import NDArray

from clothrf_core.camera_model import project, rays
from clothrf_core.geometry import look_at
from clothrf_core.interfaces import RenderedCamera
from clothrf_core.scene import Label, Picture, Scene, SceneMesh, sphere
from clothrf_core.types import CameraModel, Float, Float32

DEPTH_TOLERANCE = 5e-5
Make = Callable[[], RenderedCamera]


def check_rendered_camera(make: Make) -> None:
    """Run every check below on cameras made by `make`.

    Raises:
        AssertionError: the first promise that is broken, with numbers.
    """
    with make() as camera:
        for check in checks():
            check(camera)


def checks() -> Iterator[Callable[[RenderedCamera], None]]:
    """All checks, for suites that want one test each; they may share one opened camera."""
    yield check_nothing
    yield check_plane
    yield check_near_plane
    yield check_behind
    yield check_far_plane
    yield check_both_sides
    yield check_order
    yield check_unmeasurable
    yield check_vertices
    yield check_lens
    yield check_determinism
    yield check_frames_are_kept


def example_camera(*, distortion: Float | None = None, factor: float = 1.0) -> CameraModel:
    """A camera with an off-centre principal point, unequal focal lengths and a tilted pose."""
    K = np.array([[310.0, 0.0, 147.3], [0.0, 305.0, 131.6], [0.0, 0.0, 1.0]])
    K[:2] *= factor
    return CameraModel(
        width=round(320 * factor),
        height=round(240 * factor),
        K=K,
        T_world_camera=look_at(np.array([0.9, 0.1, 0.6]), np.array([0.35, -0.05, 0.2])),
        near=0.1,
        far=2.0,
        distortion=np.zeros(0) if distortion is None else distortion,
        provenance="contract suite",
    )


def quad(camera: CameraModel, corners: Float, label: Label = Label.CLOTH) -> SceneMesh:
    """Two triangles through four (4, 3) points given in the camera's frame."""
    return SceneMesh(
        label=label,
        vertices=_world(camera, corners),
        triangles=np.array([[0, 1, 2], [0, 2, 3]], np.int32),
        colour=(0.8, 0.4, 0.2),
    )


def plane_depth(camera: CameraModel, corners: Float) -> Float:
    """(H, W) analytic depth of the plane through (4, 3) points of the camera's frame."""
    normal = np.cross(corners[1] - corners[0], corners[2] - corners[0])
    xy = rays(camera).astype(float)
    direction = np.concatenate([xy, np.ones((*xy.shape[:2], 1))], axis=2)
    result: Float = (corners[0] @ normal) / (direction @ normal)
    return result


def check_nothing(camera: RenderedCamera) -> None:
    """An empty scene has no depth, no labels, and the background's colour everywhere."""
    model = example_camera()
    picture = camera.render(Scene(meshes=(), stamp_ns=7), model)
    frame = picture.frame
    _demand(bool(np.isnan(frame.depth).all()), "an empty scene must have NaN depth everywhere")
    _demand(not picture.labels.any(), "an empty scene must be labelled NOTHING everywhere")
    _demand(frame.stamp_ns == 7, f"stamp: expected the scene's 7 ns, got {frame.stamp_ns}")
    _demand(frame.camera is model, "the frame must name the camera that it was rendered with")
    spread = int(np.ptp(frame.rgb.reshape(-1, 3), axis=0).max())
    _demand(spread == 0, "an empty scene must have one colour")


def check_plane(camera: RenderedCamera) -> None:
    """The depth of a tilted plane is the analytic one to 0.05 mm."""
    model = example_camera()
    corners = np.array([[-2, -2, 0.5], [2, -2, 0.9], [2, 2, 1.4], [-2, 2, 1.0]], float)
    picture = camera.render(Scene(meshes=(quad(model, corners),)), model)
    error = np.abs(picture.frame.depth - plane_depth(model, corners))
    _demand(bool((picture.labels == Label.CLOTH).all()), "a plane must fill the picture")
    worst = float(error.max())
    _demand(worst <= DEPTH_TOLERANCE, f"tilted plane: depth is {1e3 * worst:.3g} mm off")


def check_near_plane(camera: RenderedCamera) -> None:
    """A triangle that reaches through the near plane is cut there, not dropped."""
    model = example_camera()
    corners = np.array([[-0.3, 0.2, -0.5], [0.3, 0.2, -0.5], [0.3, 0.2, 1.5], [-0.3, 0.2, 1.5]])
    picture = camera.render(Scene(meshes=(quad(model, corners),)), model)
    truth = plane_depth(model, corners)
    x = rays(model)[..., 0] * truth
    inside = (truth > 1.02 * model.near) & (truth < 1.48) & (np.abs(x) < 0.295)
    drawn = picture.labels == Label.CLOTH
    _demand(bool(drawn[inside].all()), "a floor that starts behind the camera has holes")
    error = float(np.abs(picture.frame.depth - truth)[inside].max())
    _demand(error <= DEPTH_TOLERANCE, f"cut floor: depth is {1e3 * error:.3g} mm off")
    nearer = drawn & (truth < 0.98 * model.near)
    _demand(not nearer.any(), "something closer than the near plane was drawn")


def check_behind(camera: RenderedCamera) -> None:
    """What lies behind the camera is not seen."""
    model = example_camera()
    corners = np.array([[-1, -1, -1], [1, -1, -1], [1, 1, -1], [-1, 1, -1]], float)
    picture = camera.render(Scene(meshes=(quad(model, corners),)), model)
    _demand(not picture.labels.any(), "a surface behind the camera was drawn")


def check_far_plane(camera: RenderedCamera) -> None:
    """Nothing beyond the far plane is seen."""
    model = example_camera()
    corners = np.array([[-9, -9, 1.9], [9, -9, 1.9], [9, 9, 2.3], [-9, 9, 2.3]], float)
    picture = camera.render(Scene(meshes=(quad(model, corners),)), model)
    truth = plane_depth(model, corners)
    beyond = truth > model.far + 1e-4
    _demand(bool(np.isnan(picture.frame.depth[beyond]).all()), "depth beyond the far plane")
    _demand(not picture.labels[beyond].any(), "a label beyond the far plane")
    within = truth < model.far - 1e-4
    _demand(bool((picture.labels[within] > 0).all()), "a surface before the far plane is missing")


def check_both_sides(camera: RenderedCamera) -> None:
    """A triangle is visible from both sides."""
    model = example_camera()
    corners = np.array([[-2, -2, 0.7], [2, -2, 0.7], [2, 2, 0.7], [-2, 2, 0.7]], float)
    for turned in (corners, corners[::-1].copy()):
        picture = camera.render(Scene(meshes=(quad(model, turned),)), model)
        full = bool((picture.labels == Label.CLOTH).all())
        _demand(full, "a triangle must be visible from both sides")


def check_order(camera: RenderedCamera) -> None:
    """The closest surface wins whatever the order of the meshes."""
    model = example_camera()
    back = np.array([[-2, -2, 1.2], [2, -2, 1.2], [2, 2, 1.2], [-2, 2, 1.2]], float)
    front = np.array([[-0.1, -0.1, 0.6], [0.1, -0.1, 0.6], [0.1, 0.1, 0.6], [-0.1, 0.1, 0.6]])
    meshes = (quad(model, back, Label.TABLE), quad(model, front, Label.HAND))
    one = camera.render(Scene(meshes=meshes), model)
    two = camera.render(Scene(meshes=meshes[::-1]), model)
    _same_picture(one, two, "the order of the meshes changed the picture")
    _demand(bool((one.labels == Label.HAND).any()), "the surface in front is missing")
    hand = one.labels == Label.HAND
    depth = one.frame.depth
    _demand(bool(np.allclose(depth[hand], 0.6, atol=DEPTH_TOLERANCE)), "depth of the front quad")
    _demand(bool(np.allclose(depth[~hand], 1.2, atol=DEPTH_TOLERANCE)), "depth of the back quad")


def check_unmeasurable(camera: RenderedCamera) -> None:
    """A surface that gives no depth hides what is behind it and has NaN depth."""
    model = example_camera()
    back = np.array([[-2, -2, 1.2], [2, -2, 1.2], [2, 2, 1.2], [-2, 2, 1.2]], float)
    front = np.array([[-0.1, -0.1, 0.6], [0.1, -0.1, 0.6], [0.1, 0.1, 0.6], [-0.1, 0.1, 0.6]])
    steel = dataclasses.replace(quad(model, front, Label.GRIPPER), measurable=False)
    wall = quad(model, back, Label.BACKDROP)
    for meshes in ((steel, wall), (wall, steel)):
        picture = camera.render(Scene(meshes=meshes), model)
        metal = picture.labels == Label.GRIPPER
        _demand(metal.sum() > 1000, "a surface without depth must still be drawn")
        holes = np.isnan(picture.frame.depth)
        _demand(bool((holes == metal).all()), "NaN depth exactly where no depth is measurable")
    behind = dataclasses.replace(wall, measurable=False)
    visible = camera.render(Scene(meshes=(behind, quad(model, front, Label.CLOTH))), model)
    cloth = visible.labels == Label.CLOTH
    _demand(
        bool((np.isfinite(visible.frame.depth) == cloth).all()),
        "a surface in front of one without depth must keep its own depth",
    )


def check_vertices(camera: RenderedCamera) -> None:
    """Small quads appear within 0.1 pixel of where `project` (OpenCV's formula) puts them."""
    _check_positions(camera, example_camera(factor=2.0), rim_pixels=0.1)


def check_lens(camera: RenderedCamera) -> None:
    """With distortion too, in position and in the depth of a tilted plane.

    Labels may come from the nearest pixel of a pinhole picture, so a rim may be 0.75 pixels off.
    """
    bent = np.array([0.12, -0.25, 0.002, -0.001, 0.08])
    _check_positions(camera, example_camera(distortion=bent, factor=2.0), rim_pixels=0.75)
    model = example_camera(distortion=bent)
    corners = np.array([[-2, -2, 0.5], [2, -2, 0.9], [2, 2, 1.4], [-2, 2, 1.0]], float)
    picture = camera.render(Scene(meshes=(quad(model, corners),)), model)
    worst = float(np.abs(picture.frame.depth - plane_depth(model, corners)).max())
    _demand(
        worst <= 2 * DEPTH_TOLERANCE, f"plane through a lens: depth is {1e3 * worst:.3g} mm off"
    )
    _demand(picture.frame.camera is model, "the frame must name the camera with its distortion")


def _check_positions(camera: RenderedCamera, model: CameraModel, *, rim_pixels: float) -> None:
    """A pixel is drawn if and only if its ray hits the square, but for `rim_pixels` at the rim."""
    side, z = 0.03, 0.8
    # Turned by half a radian, so that the rims cross pixels everywhere.
    turn = np.array([[np.cos(0.5), np.sin(0.5)], [-np.sin(0.5), np.cos(0.5)]])
    xy = z * rays(model).astype(float)
    for x in (-0.30, 0.05, 0.32):
        for y in (-0.24, 0.02, 0.20):
            centre = np.array([x, y, 1.0]) * z
            offsets = np.zeros((4, 3))
            offsets[:, :2] = side * np.array([[-1, -1], [1, -1], [1, 1], [-1, 1]], float) @ turn
            picture = camera.render(Scene(meshes=(quad(model, centre + offsets),)), model)
            drawn = picture.labels > 0
            rim = np.abs((xy - centre[:2]) @ turn.T).max(axis=2) - side
            where, _ = project(model, _world(model, centre[None]))
            text = f"the square at pixel {where[0].round(1).tolist()}"
            _demand(drawn.any(), f"{text} is missing")
            off = np.abs(rim[(rim < 0) != drawn]).max(initial=0.0) * float(model.K[0, 0]) / z
            _demand(off <= rim_pixels, f"the rim of {text} was drawn {off:.2f} pixels off")


def _world(camera: CameraModel, points: Float) -> Float:
    T = camera.T_world_camera
    result: Float = points @ T[:3, :3].T + T[:3, 3]
    return result


def check_determinism(camera: RenderedCamera) -> None:
    """The same scene gives the same bits, whatever was drawn in between."""
    model = example_camera()
    scene = example_scene(model)
    first = camera.render(scene, model)
    again = camera.render(scene, model)
    _same_picture(first, again, "the second picture of the same scene differs")
    camera.render(Scene(meshes=scene.meshes[:2]), example_camera(factor=0.5))
    camera.render(Scene(meshes=scene.meshes[1:]), model)
    later = camera.render(scene, model)
    _same_picture(first, later, "the picture depends on what was drawn before")


def check_frames_are_kept(camera: RenderedCamera) -> None:
    """A picture stays as it was when the next one is drawn, and cannot be written."""
    model = example_camera()
    scene = example_scene(model)
    picture = camera.render(scene, model)
    depth, labels = picture.frame.depth.copy(), picture.labels.copy()
    camera.render(Scene(meshes=()), model)
    _demand(
        np.array_equal(depth, picture.frame.depth, equal_nan=True)
        and np.array_equal(labels, picture.labels),
        "drawing a second picture changed the first",
    )
    _demand(
        not (picture.frame.depth.flags.writeable or picture.labels.flags.writeable),
        "the arrays of a picture must be read-only",
    )


def example_scene(camera: CameraModel) -> Scene:
    """A wavy cloth over a table, with two round hands, in front of `camera`."""
    u, v = np.meshgrid(np.linspace(-0.2, 0.2, 13), np.linspace(-0.15, 0.15, 11), indexing="ij")
    z = 0.7 + 0.03 * np.sin(12 * u + 5 * v)
    i, j = np.meshgrid(np.arange(12), np.arange(10), indexing="ij")
    a = (11 * i + j).ravel()
    triangles = np.concatenate(
        [np.stack([a, a + 1, a + 11], 1), np.stack([a + 1, a + 12, a + 11], 1)]
    )
    points = _world(camera, np.stack([u, v, z], axis=-1).reshape(-1, 3))
    cloth = SceneMesh(Label.CLOTH, points, triangles.astype(np.int32), (0.1, 0.45, 0.5))
    floor = np.array([[-2, 0.25, 0.3], [2, 0.25, 0.3], [2, 0.2, 1.8], [-2, 0.2, 1.8]])
    hands = [sphere(points[k], 0.03, Label.HAND, (0.7, 0.5, 0.4)) for k in (0, -1)]
    return Scene(meshes=(cloth, *hands, quad(camera, floor, Label.TABLE)), stamp_ns=1)


def differences(one: Picture, two: Picture, *, step: float = 0.02) -> tuple[Float32, float]:
    """Depth differences and the share of differing labels of two pictures, away from edges.

    A pixel counts if both pictures show one surface in its 3 x 3 neighbourhood, with relative depth
    steps below `step`.
    """
    core = _flat(one, step) & _flat(two, step)
    delta = np.abs(one.frame.depth - two.frame.depth)[core]
    interior = _one_label(one.labels)
    share = float(np.mean((one.labels != two.labels)[interior])) if interior.any() else 0.0
    return delta.astype(np.float32), share


def _one_label(labels: NDArray[np.uint8]) -> NDArray[np.bool_]:
    result = np.zeros(labels.shape, bool)
    middle = labels[1:-1, 1:-1]
    result[1:-1, 1:-1] = True
    for dy in (0, 1, 2):
        for dx in (0, 1, 2):
            h, w = labels.shape
            result[1:-1, 1:-1] &= labels[dy : h - 2 + dy, dx : w - 2 + dx] == middle
    return result


def _flat(picture: Picture, step: float) -> NDArray[np.bool_]:
    depth = picture.frame.depth
    h, w = depth.shape
    result = _one_label(picture.labels) & np.isfinite(depth)
    middle = depth[1:-1, 1:-1]
    for dy in (0, 1, 2):
        for dx in (0, 1, 2):
            other = depth[dy : h - 2 + dy, dx : w - 2 + dx]
            with np.errstate(invalid="ignore"):
                result[1:-1, 1:-1] &= np.abs(other - middle) < step * middle
    return result


def _same_picture(one: Picture, two: Picture, message: str) -> None:
    _demand(np.array_equal(one.labels, two.labels), f"{message} (labels)")
    _demand(np.array_equal(one.frame.depth, two.frame.depth, equal_nan=True), f"{message} (depth)")
    _demand(np.array_equal(one.frame.rgb, two.frame.rgb), f"{message} (colour)")


def _demand(fact: bool | np.bool_, message: str) -> None:  # noqa: FBT001
    if not fact:
        raise AssertionError(message)
