"""A camera that renders a board being carried about: to learn the procedure without hardware."""

from __future__ import annotations

import cv2
import numpy as np
from typing_extensions import override

from clothrf_calibration import rigid
from clothrf_calibration.boards import Board
from clothrf_calibration.simcamera import board_scene
from clothrf_calibration.synthetic import board_poses
from clothrf_core.camera_model import scaled
from clothrf_core.errors import StaleFrame
from clothrf_core.interfaces import RenderedCamera
from clothrf_core.opening import CameraAround
from clothrf_core.types import CameraModel, Float, RgbdFrame

SUPERSAMPLING = 3
PERIOD_NS = 33_000_000


class PracticeCamera(CameraAround):
    """Renders the board at random places; a robot carries it with a known grip.

    Attributes:
        T_gripper_board: (4, 4) how the gripper holds the board.
    """

    def __init__(
        self,
        renderer: RenderedCamera,
        model: CameraModel,
        board: Board,
        rng: np.random.Generator,
        *,
        count: int,
        noise: float = 2.0,
    ) -> None:
        super().__init__(renderer)
        self._renderer, self._model, self._board = renderer, model, board
        self._rng, self._noise = rng, noise
        size = float(np.linalg.norm(np.ptp(board.points[:, :2], axis=0)))
        fill = size * float(model.K[0, 0]) / model.width
        self._places = model.T_world_camera @ board_poses(
            rng, board, count, tilt=0.7, distance=(1.5 * fill, 2.8 * fill), spread=0.16
        )
        self.T_gripper_board = np.eye(4)
        self.T_gripper_board[:3, :3] = rigid.exp(np.array([0.2, -0.1, 0.4]))
        self.T_gripper_board[:3, 3] = [0.03, -0.05, 0.08]
        self._index = -1

    @override
    def read(self, timeout_s: float = 1.0) -> RgbdFrame:
        if self._index + 1 >= len(self._places):
            raise StaleFrame(f"all {len(self._places)} practice pictures have been shown")
        self._index += 1
        scene = board_scene(self._board, self._places[self._index])
        big = self._renderer.render(scene, scaled(self._model, SUPERSAMPLING)).frame
        size = (self._model.width, self._model.height)
        rgb = cv2.resize(src=np.asarray(big.rgb), dsize=size, interpolation=cv2.INTER_AREA)
        noisy = rgb + self._noise * self._rng.normal(size=rgb.shape)
        middle = SUPERSAMPLING // 2
        depth = np.ascontiguousarray(big.depth[middle::SUPERSAMPLING, middle::SUPERSAMPLING])
        return RgbdFrame(
            stamp_ns=(self._index + 1) * PERIOD_NS,
            rgb=np.clip(np.round(noisy), 0, 255).astype(np.uint8),
            depth=depth,
            camera=self._model,
        )

    def pose(self) -> Float:
        """(4, 4) T_base_gripper of the picture read last."""
        T: Float = self._places[self._index] @ rigid.inverse(self.T_gripper_board)
        return T
