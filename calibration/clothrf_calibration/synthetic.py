"""Views and poses of rigs whose truth is known: for tests, benchmarks and trying the tools."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from clothrf_calibration import rigid
from clothrf_calibration.boards import Board
from clothrf_calibration.lens import project, vector
from clothrf_calibration.views import View
from clothrf_core.camera_model import scaled
from clothrf_core.types import CameraModel, Float


def camera(*, distortion: tuple[float, ...] = (0.06, -0.15, 0.0008, -0.0005)) -> CameraModel:
    """A 640 x 480 camera like a D435's colour camera, with an off-centre principal point."""
    K = np.array([[615.6, 0.0, 325.3], [0.0, 616.1, 233.2], [0.0, 0.0, 1.0]])
    return CameraModel(
        width=640,
        height=480,
        K=K,
        T_world_camera=np.eye(4),
        distortion=np.array(distortion, float),
        provenance="synthetic",
    )


def enlarged(model: CameraModel, factor: float) -> CameraModel:
    """The same camera with `factor` times as many pixels a side."""
    return scaled(model, factor)


def board_poses(
    rng: np.random.Generator,
    board: Board,
    count: int,
    *,
    tilt: float = 0.8,
    distance: tuple[float, float] = (0.35, 0.7),
    spread: float = 0.12,
) -> Float:
    """(count, 4, 4) T_camera_board: tilted about random axes, board's middle near the axis."""
    T = np.tile(np.eye(4), (count, 1, 1))
    middle = board.points.mean(axis=0)
    for n in range(count):
        z = rng.uniform(*distance)
        axis = rng.normal(size=3) * [1.0, 1.0, 0.4]
        turn = rng.uniform(0.3, 1.0) * tilt * axis / np.linalg.norm(axis)
        T[n, :3, :3] = rigid.exp(turn)
        centre = np.array([rng.uniform(-1, 1) * 1.6, rng.uniform(-1, 1), 0.0]) * spread * z / 0.5
        T[n, :3, 3] = centre + [0, 0, z] - T[n, :3, :3] @ middle
    return T


def views(
    rng: np.random.Generator,
    board: Board,
    model: CameraModel,
    T_camera_board: Float,
    *,
    noise: float = 0.2,
    points: Float | None = None,
    minimum: int = 8,
) -> list[View]:
    """What `model` sees of the board at (V, 4, 4) poses, with Gaussian noise of `noise` pixels.

    Points outside the picture are missing; views with fewer than `minimum` points are empty.
    """
    parameters = vector(model.K, model.distortion)
    real = board.points if points is None else points
    result = []
    for n, T in enumerate(T_camera_board):
        local = real @ T[:3, :3].T + T[:3, 3]
        pixels = project(parameters, np.where(local[:, 2:] > 0.01, local, [0.0, 0.0, 1.0]))
        seen = (local[:, 2] > 0.01) & (pixels > 2.0).all(axis=1)
        seen &= (pixels[:, 0] < model.width - 3) & (pixels[:, 1] < model.height - 3)
        if seen.sum() < minimum:
            seen[:] = False
        noisy = pixels + noise * rng.normal(size=pixels.shape)
        result.append(
            View(f"view{n:03d}", (model.width, model.height), np.nonzero(seen)[0], noisy[seen])
        )
    return result


@dataclass(frozen=True, slots=True, eq=False)
class HandEyeRig:
    """A robot, a camera and a board, with the truth.

    Attributes:
        setup: ``fixed`` (board on the gripper) or ``hand`` (camera on the gripper).
        T_base_gripper: (V, 4, 4) poses as the robot reports them.
        views: what the camera saw.
        X: (4, 4) T_base_camera (fixed) or T_gripper_camera (hand).
        Z: (4, 4) T_gripper_board (fixed) or T_base_board (hand).
    """

    setup: str
    T_base_gripper: Float
    views: list[View]
    X: Float
    Z: Float


def hand_eye_rig(
    rng: np.random.Generator,
    board: Board,
    model: CameraModel,
    count: int,
    *,
    setup: str = "fixed",
    noise: float = 0.2,
    robot_mm: float = 0.0,
    robot_deg: float = 0.0,
    tilt: float = 0.6,
) -> HandEyeRig:
    """A random rig of `count` views; the robot reports poses with the given error."""
    random = np.eye(4)
    random[:3, :3] = rigid.exp(rng.normal(size=3) * 0.8)
    random[:3, 3] = rng.uniform(-0.3, 0.3, 3) + [0.6, 0.0, 0.5]
    Z = np.eye(4)
    Z[:3, :3] = rigid.exp(rng.normal(size=3) * 0.8)
    Z[:3, 3] = rng.uniform(-0.05, 0.05, 3) + (0.0 if setup == "fixed" else 0.4)
    X = random if setup == "fixed" else np.eye(4)
    if setup == "hand":
        X[:3, :3] = rigid.exp(rng.normal(size=3) * 0.5)
        X[:3, 3] = rng.uniform(-0.08, 0.08, 3)
    C = board_poses(rng, board, count, tilt=tilt, distance=(0.5, 0.9))
    G = X @ C @ rigid.inverse(Z) if setup == "fixed" else Z @ rigid.inverse(C) @ rigid.inverse(X)
    error = np.tile(np.eye(4), (count, 1, 1))
    error[:, :3, :3] = rigid.exp(np.radians(robot_deg) / np.sqrt(3) * rng.normal(size=(count, 3)))
    error[:, :3, 3] = 1e-3 * robot_mm / np.sqrt(3) * rng.normal(size=(count, 3))
    return HandEyeRig(setup, G @ error, views(rng, board, model, C, noise=noise), X, Z)
