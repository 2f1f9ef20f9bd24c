"""The rendered camera that needs no graphics driver."""

from __future__ import annotations

import importlib.util
import threading
from types import TracebackType
from typing import Self, cast

from typing_extensions import override

from clothrf_core.interfaces import RenderedCamera
from clothrf_core.lens import LensCache
from clothrf_core.provider import BuildContext
from clothrf_core.rendering import WorldReader
from clothrf_core.scene import Picture, Scene
from clothrf_core.types import CameraModel, RgbdFrame
from clothrf_raster.bend import Bend, BendCache
from clothrf_raster.config import RasterConfig
from clothrf_raster.drawing import Drawing, Engine, board_key


class RasterCamera(RenderedCamera):
    """Draws scenes on the CPU; safe to share between threads, which draw side by side."""

    def __init__(self, config: RasterConfig, context: BuildContext | None = None) -> None:
        self._config = config
        self._engine = engine(config)
        self._own = _Own()
        self._reader = WorldReader(
            "raster", context.world if context is not None else None, self.render
        )

    @override
    def __enter__(self) -> Self:
        self._reader.restart()
        return self

    @override
    def __exit__(
        self,
        kind: type[BaseException] | None,
        error: BaseException | None,
        trace: TracebackType | None,
    ) -> None:
        self._own = _Own()

    @override
    def read(self, timeout_s: float = 1.0) -> RgbdFrame:
        return self._reader.read(timeout_s)

    @override
    def render(self, scene: Scene, camera: CameraModel) -> Picture:
        board = self._own.board
        if board is not None and board.key == board_key(scene, camera, colour=self._config.colour):
            return self._draw(board, scene, camera)
        bend = self._own.bends.of(camera)
        if bend is not None:
            return self._draw(self._board(scene, camera, bend), scene, camera)
        lens = self._own.lenses.of(camera)
        pinhole = lens.pinhole(camera)
        picture = self._draw(self._board(scene, pinhole, Bend.none()), scene, pinhole)
        return lens.bend(picture, camera, colour=self._config.colour)

    def _board(self, scene: Scene, camera: CameraModel, bend: Bend) -> Drawing:
        colour = self._config.colour
        board = self._own.board
        if board is None or board.key != board_key(scene, camera, colour=colour):
            board = Drawing.board(self._engine, scene, camera, bend, colour=colour)
            self._own.board = board
        return board

    def _draw(self, board: Drawing, scene: Scene, camera: CameraModel) -> Picture:
        canvas = board.draw(scene)
        depth, labels = board.depths.take(), board.labels.take()
        self._engine.finish(canvas, board.view, depth, labels)
        rgb = canvas.rgb if self._config.colour else board.black
        frame = RgbdFrame(stamp_ns=scene.stamp_ns, rgb=rgb, depth=depth, camera=camera)
        return Picture(frame=frame, labels=labels)


class _Own(threading.local):
    """What each thread keeps between frames."""

    board: Drawing | None = None

    def __init__(self) -> None:
        self.lenses = LensCache()
        self.bends = BendCache()


def engine(config: RasterConfig) -> Engine:
    """The module that draws, as configured; an ImportError tells that numba is missing."""
    if config.engine == "numpy" or (
        config.engine == "auto" and importlib.util.find_spec("numba") is None
    ):
        from clothrf_raster import plain

        return cast(Engine, plain)
    from clothrf_raster import compiled

    return cast(Engine, compiled)
