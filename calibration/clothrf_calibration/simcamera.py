"""From a calibration to the rendered camera: clip planes from the workspace, and a proof.

The proof renders the board at known places with any rendered camera and compares what is seen with
what ``cv2.projectPoints`` and the plane's equation say.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import cv2
import numpy as np

from clothrf_calibration import rigid
from clothrf_calibration.boarddrawing import drawing
from clothrf_calibration.boards import Board
from clothrf_calibration.detect import detect
from clothrf_calibration.errors import BoardNotFound
from clothrf_core.camera_model import clip_range, rays, scaled
from clothrf_core.interfaces import RenderedCamera
from clothrf_core.rig import Rig
from clothrf_core.scene import Label, Light, Scene, SceneMesh
from clothrf_core.types import CameraModel, Float

SUPERSAMPLING = 4
BLUR = 1.0
# The white sheet lies this far behind the black squares, so that neither hides the other.
BEHIND = 2e-5


@dataclass(frozen=True, slots=True, eq=False)
class Check:
    """How a rendered camera compares with the calibrated one.

    Attributes:
        backend: name of the rendered camera.
        poses: places of the board.
        corners: corners compared.
        rms_px: distance between rendered and projected corners.
        mean_px: (2,) mean offset; half a pixel here is the classic mistake.
        worst_px: largest distance.
        depth_median_mm: median absolute depth error on the board's plane.
        depth_worst_mm: 99.9th percentile of it, away from the board's edge.
    """

    backend: str
    poses: int
    corners: int
    rms_px: float
    mean_px: Float
    worst_px: float
    depth_median_mm: float
    depth_worst_mm: float

    @property
    def good(self) -> bool:
        """Within 0.1 px and 1 mm."""
        return self.rms_px <= 0.1 and self.depth_worst_mm <= 1.0


def workspace_clip(camera: CameraModel, rig: Rig) -> tuple[float, float]:
    """Near and far planes that hold the rig's workspace, its hands, its grippers and its table."""
    points = np.concatenate(
        [
            [rig.foreground.low, rig.foreground.high, rig.table.low, rig.table.high],
            rig.rest_hands - rig.hands.range,
            rig.rest_hands + rig.hands.range,
            rig.rest_grasp,
        ]
    )
    return clip_range(camera, points.min(axis=0), points.max(axis=0))


def board_scene(board: Board, T_world_board: Float) -> Scene:
    """The board as something to draw: a white sheet with black squares, lit from the camera."""
    drawn = drawing(board)
    margin = board.square
    sheet = np.array([[*(drawn.low - margin), *(drawn.high + margin)]])
    white = _quads(sheet, T_world_board, BEHIND, (1.0, 1.0, 1.0))
    meshes = [white]
    if len(drawn.rectangles):
        meshes.append(_quads(drawn.rectangles, T_world_board, 0.0, (0.0, 0.0, 0.0)))
    if len(drawn.discs):
        meshes.append(_discs(drawn.discs, T_world_board))
    return Scene(
        meshes=tuple(meshes),
        light=Light(intensity=0.0, ambient=1.0),
        background=(0.5, 0.5, 0.5),
    )


def check_poses(camera: CameraModel, board: Board, count: int = 6, *, seed: int = 0) -> Float:
    """(count, 4, 4) T_world_board: in view, tilted, from near to far, also in the corners."""
    rng = np.random.default_rng(seed)
    size = float(np.linalg.norm(np.ptp(board.points[:, :2], axis=0)))
    field = min(camera.width / camera.K[0, 0], camera.height / camera.K[1, 1])
    middle = board.points.mean(axis=0)
    poses = []
    places = [(0.0, 0.0), (-0.4, -0.4), (0.4, -0.4), (-0.4, 0.4), (0.4, 0.4), (0.0, 0.2)]
    for n in range(count):
        z = size / field * float(rng.uniform(1.5, 2.2))
        u, v = places[n % len(places)]
        shift = 0.8 * (1.0 - size / (z * field)) if n % len(places) else 0.0
        T = np.eye(4)
        T[:3, :3] = rigid.exp(rng.uniform(-0.35, 0.35, 3) * [1, 1, 0.3])
        xy = np.array([u * shift * camera.width, v * shift * camera.height])
        centre = np.array([*(xy / [camera.K[0, 0], camera.K[1, 1]] * z), z])
        T[:3, 3] = centre - T[:3, :3] @ middle
        poses.append(camera.T_world_camera @ T)
    return np.stack(poses)


def check(
    backend: str,
    renderer: RenderedCamera,
    camera: CameraModel,
    board: Board,
    T_world_board: Sequence[Float] | Float,
) -> Check:
    """Render the board at every (4, 4) place and compare.

    Raises:
        BoardNotFound: the board cannot be read from any rendering.
    """
    errors = []
    # One size after the other: a renderer sets its targets up anew when the size changes.
    for T in T_world_board:
        found, truth = _corners(renderer, camera, board, T)
        if found is not None:
            errors.append(found - truth)
    depths = [_depth_errors(renderer, camera, board, T) for T in T_world_board]
    if not errors:
        raise BoardNotFound(f"{backend}: the rendered board cannot be read in any picture")
    error, depth = np.concatenate(errors), 1e3 * np.concatenate(depths)
    distance = np.linalg.norm(error, axis=1)
    return Check(
        backend,
        len(errors),
        len(error),
        float(np.sqrt((distance**2).mean())),
        error.mean(axis=0),
        float(distance.max()),
        float(np.median(depth)),
        float(np.percentile(depth, 99.9)),
    )


def _corners(
    renderer: RenderedCamera, camera: CameraModel, board: Board, T: Float
) -> tuple[Float | None, Float]:
    """Corners in the rendering and by `cv2.projectPoints`."""
    big = renderer.render(board_scene(board, T), scaled(camera, SUPERSAMPLING)).frame.rgb
    grey = cv2.cvtColor(src=np.asarray(big), code=cv2.COLOR_RGB2GRAY)
    image = cv2.resize(src=grey, dsize=(camera.width, camera.height), interpolation=cv2.INTER_AREA)
    image = cv2.GaussianBlur(src=image, ksize=(0, 0), sigmaX=BLUR)
    T_camera_board = rigid.inverse(camera.T_world_camera) @ T
    projected, _ = cv2.projectPoints(
        objectPoints=board.points,
        rvec=cv2.Rodrigues(src=T_camera_board[:3, :3])[0],
        tvec=T_camera_board[:3, 3],
        cameraMatrix=camera.K,
        distCoeffs=camera.distortion if camera.distortion.size else np.zeros(5),
    )
    truth = np.asarray(projected, float).reshape(-1, 2)
    found = detect(board, np.asarray(image, np.uint8))
    if found is None:
        return None, truth
    if board.turnable and np.abs(found.pixels - truth[found.ids]).max() > 10:
        return found.pixels, truth[len(truth) - 1 - found.ids]
    return found.pixels, truth[found.ids]


def _depth_errors(renderer: RenderedCamera, camera: CameraModel, board: Board, T: Float) -> Float:
    """Absolute depth errors, metres, on the board's plane away from its edge."""
    depth = renderer.render(board_scene(board, T), camera).frame.depth
    T_camera_board = rigid.inverse(camera.T_world_camera) @ T
    normal, origin = T_camera_board[:3, 2], T_camera_board[:3, 3]
    ray = rays(camera).astype(float)
    with np.errstate(divide="ignore"):
        z = normal @ origin / (ray @ normal[:2] + normal[2])
    point = np.concatenate([ray * z[:, :, None], z[:, :, None]], axis=2)
    local = (point - origin) @ T_camera_board[:3, :3]
    drawn = drawing(board)
    inside = (local[:, :, :2] > drawn.low).all(axis=2) & (local[:, :, :2] < drawn.high).all(axis=2)
    error = np.abs(depth - z)[inside]
    return np.where(np.isnan(error), 1.0, error)


def _quads(
    rectangles: Float, T: Float, behind: float, colour: tuple[float, float, float]
) -> SceneMesh:
    x0, y0, x1, y1 = rectangles.T
    z = np.full_like(x0, behind)
    corners = np.stack(
        [np.stack(c, axis=1) for c in ((x0, y0, z), (x1, y0, z), (x1, y1, z), (x0, y1, z))], axis=1
    ).reshape(-1, 3)
    first = 4 * np.arange(len(rectangles))[:, None]
    triangles = np.concatenate([first + [0, 1, 2], first + [0, 2, 3]]).astype(np.int32)
    return SceneMesh(Label.BACKDROP, corners @ T[:3, :3].T + T[:3, 3], triangles, colour)


def _discs(discs: Float, T: Float, *, sides: int = 64) -> SceneMesh:
    turn = np.linspace(0.0, 2.0 * np.pi, sides, endpoint=False)
    # A polygon of the disc's area.
    grow = np.sqrt(2 * np.pi / sides / np.sin(2 * np.pi / sides))
    ring = np.stack([np.cos(turn), np.sin(turn)], axis=1)
    vertices, triangles = [], []
    for n, (x, y, r) in enumerate(discs):
        around = np.array([x, y]) + grow * r * ring
        flat = np.concatenate([[[x, y]], around])
        vertices.append(np.concatenate([flat, np.zeros((sides + 1, 1))], axis=1))
        k = np.arange(sides)
        fan = np.stack([np.zeros_like(k), k + 1, (k + 1) % sides + 1], axis=1)
        triangles.append(fan + n * (sides + 1))
    corners = np.concatenate(vertices) @ T[:3, :3].T + T[:3, 3]
    return SceneMesh(
        Label.BACKDROP, corners, np.concatenate(triangles).astype(np.int32), (0.0, 0.0, 0.0)
    )
