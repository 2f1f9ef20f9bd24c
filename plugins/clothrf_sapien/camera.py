"""The rendered camera on SAPIEN: a GPU where there is one, else Mesa's lavapipe.

Its shaders are our own (`shaders/`): one pass that writes colour, code and exact depth into one
picture. SAPIEN's `minimal` pack takes two passes through general materials and gives the same
numbers at nine times the processor time on lavapipe, and half a minute instead of half a second
for the first frame (measured on two cores).
"""

from __future__ import annotations

import threading
from types import TracebackType
from typing import Self

import numpy as np
from numpy.typing import NDArray
from typing_extensions import override

from clothrf_core.interfaces import RenderedCamera
from clothrf_core.lens import LensCache
from clothrf_core.provider import BuildContext
from clothrf_core.rendering import WorldReader
from clothrf_core.scene import Picture, Scene
from clothrf_core.types import CameraModel, RgbdFrame
from clothrf_sapien.camera_config import SapienCameraConfig
from clothrf_sapien.studio import Studio
from clothrf_sapien.unpacking import unpack


class SapienCamera(RenderedCamera):
    """Draws scenes with SAPIEN; the renderer starts with the first picture.

    SAPIEN's renderer belongs to one thread at a time: pictures asked for by several threads are
    drawn one after the other.

    Raises:
        MissingDependency: (from `render` and `read`) no Vulkan driver that SAPIEN can use.
    """

    def __init__(self, config: SapienCameraConfig, context: BuildContext | None = None) -> None:
        self._config = config
        self._studio: Studio | None = None
        self._lenses = LensCache()
        self._turn = threading.Lock()
        self._reader = WorldReader(
            "sapien", context.world if context is not None else None, self.render
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
        with self._turn:
            self._studio = None

    @override
    def read(self, timeout_s: float = 1.0) -> RgbdFrame:
        return self._reader.read(timeout_s)

    @override
    def render(self, scene: Scene, camera: CameraModel) -> Picture:
        with self._turn:
            if not camera.distortion.any():
                return self._draw(scene, camera)
            lens = self._lenses.of(camera)
            return lens.bend(self._draw(scene, lens.pinhole(camera)), camera)

    def _draw(self, scene: Scene, camera: CameraModel) -> Picture:
        if self._studio is None:
            self._studio = Studio(self._config)
        packed = self._studio.shoot(scene, camera)
        shape = (camera.height, camera.width)
        rgb = np.empty((*shape, 3), np.uint8)
        depth = np.empty(shape, np.float32)
        labels = np.empty(shape, np.uint8)
        unpack(packed, display(scene.background), rgb, depth, labels)
        frame = RgbdFrame(stamp_ns=scene.stamp_ns, rgb=rgb, depth=depth, camera=camera)
        return Picture(frame=frame, labels=labels)


def display(linear: tuple[float, float, float]) -> NDArray[np.uint8]:
    """(3,) uint8 display colour of a linear RGB colour in [0, 1], gamma 2.2."""
    values = 255.0 * np.clip(np.asarray(linear, float), 0.0, 1.0) ** (1.0 / 2.2)
    result: NDArray[np.uint8] = np.rint(values).astype(np.uint8)
    return result
