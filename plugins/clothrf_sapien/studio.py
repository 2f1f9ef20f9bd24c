"""A SAPIEN scene that shows one `Scene` at a time to one camera."""

from __future__ import annotations

from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from clothrf_core.errors import MissingDependency
from clothrf_core.scene import Light, Scene
from clothrf_core.types import CameraModel, Float
from clothrf_sapien.body import Body, make_body
from clothrf_sapien.camera_config import SapienCameraConfig
from clothrf_sapien.vulkan import MEND

SHADERS = Path(__file__).parent / "shaders"
# SAPIEN's camera looks along +x with z up; columns are its axes in OpenCV's camera frame.
OPENCV_FROM_SAPIEN = np.array(
    [[0.0, -1.0, 0.0, 0.0], [0.0, 0.0, -1.0, 0.0], [1.0, 0.0, 0.0, 0.0], [0.0, 0.0, 0.0, 1.0]]
)


class Studio:
    """Entities that mirror the meshes, one light, one camera; all rebuilt only when they change.

    Raises:
        MissingDependency: SAPIEN finds no Vulkan device to draw with.
    """

    def __init__(self, config: SapienCameraConfig) -> None:
        import sapien
        from sapien import render

        self._config = config
        try:
            self._system = render.RenderSystem(config.device or None)
            self._scene = sapien.Scene([self._system])
        except RuntimeError as error:
            raise MissingDependency(
                f"camera 'sapien' needs a Vulkan driver, and SAPIEN says: {error}. Mend it: {MEND}"
            ) from error
        self._bodies: list[Body] = []
        self._light: Any = None
        self._light_key: tuple[object, ...] = ()
        self._camera: Any = None
        self._camera_key: tuple[object, ...] = ()

    def shoot(self, scene: Scene, camera: CameraModel) -> NDArray[np.uint32]:
        """(H, W, 4) uint32: packed colour and code, bits of float32 depth, and nothing, twice."""
        self._show(scene, np.array(camera.T_world_camera[:3, 3]))
        self._light_up(scene)
        self._aim(camera)
        self._scene.update_render()
        try:
            self._camera.take_picture()
        finally:
            # Drawing goes on behind our back; SAPIEN crashes if the scene goes away meanwhile.
            packed: NDArray[np.uint32] = self._camera.get_picture("Packed")
        return packed

    def _show(self, scene: Scene, eye: Float) -> None:
        meshes = [mesh for mesh in scene.meshes if len(mesh.triangles)]
        shadows = self._config.shadows
        for body in self._bodies[len(meshes) :]:
            self._scene.remove_entity(body.entity)
        del self._bodies[len(meshes) :]
        for i, mesh in enumerate(meshes):
            if i < len(self._bodies):
                if self._bodies[i].shows(mesh, eye):
                    continue
                self._scene.remove_entity(self._bodies[i].entity)
                self._bodies[i] = make_body(mesh, eye, shadows=shadows)
            else:
                self._bodies.append(make_body(mesh, eye, shadows=shadows))
            self._scene.add_entity(self._bodies[i].entity)

    def _light_up(self, scene: Scene) -> None:
        light = scene.light
        place = _middle(scene) if self._config.shadows else (np.zeros(3), 1.0)
        key = (*light.direction, light.intensity, light.ambient, *place[0].tolist(), place[1])
        if key == self._light_key:
            return
        if self._light is not None:
            self._scene.remove_entity(self._light)
        self._system.ambient_light = [light.ambient] * 3
        self._light = self._lamp(light, *place)
        self._scene.add_entity(self._light)
        self._light_key = key

    def _lamp(self, light: Light, centre: Float, radius: float) -> Any:
        import sapien
        from sapien import render

        lamp = render.RenderDirectionalLightComponent()
        lamp.color = [light.intensity] * 3
        if self._config.shadows:
            lamp.shadow = True
            lamp.shadow_half_size = radius
            lamp.shadow_near = -radius
            lamp.shadow_far = radius
            lamp.shadow_map_size = self._config.shadow_map_size
        entity = sapien.Entity()
        entity.add_component(lamp)
        direction = np.asarray(light.direction, float)
        turn = sapien.math.shortest_rotation([1, 0, 0], direction / np.linalg.norm(direction))
        entity.set_pose(sapien.Pose(centre, turn))
        return entity

    def _aim(self, camera: CameraModel) -> None:
        import sapien
        from sapien import render

        size = (camera.width, camera.height)
        if self._camera is None or self._camera_key[:2] != size:
            if self._camera is not None:
                self._scene.remove_entity(self._camera.entity)
            pack = SHADERS / ("shadowed" if self._config.shadows else "lit")
            self._camera = render.RenderCameraComponent(*size, str(pack))
            mount = sapien.Entity()
            mount.add_component(self._camera)
            self._scene.add_entity(mount)
            self._camera_key = ()
        key = (*size, camera.near, camera.far, camera.K.tobytes(), camera.T_world_camera.tobytes())
        if key == self._camera_key:
            return
        K = camera.K
        # SAPIEN's pixel (i, j) samples (i + 0.5, j + 0.5); ours samples (i, j).
        self._camera.set_perspective_parameters(
            camera.near, camera.far, K[0, 0], K[1, 1], K[0, 2] + 0.5, K[1, 2] + 0.5, K[0, 1]
        )
        pose = (camera.T_world_camera @ OPENCV_FROM_SAPIEN).astype(np.float32)
        self._camera.entity.set_pose(sapien.Pose(pose))
        self._camera_key = key


def _middle(scene: Scene) -> tuple[Float, float]:
    """Centre and radius, m, of a ball around what may cast or receive a shadow.

    Rounded to centimetres, so that a moving cloth does not make the shadow map tremble.
    """
    points = [mesh.vertices for mesh in scene.meshes if len(mesh.triangles)]
    if not points:
        return np.zeros(3), 1.0
    low = np.min([p.min(axis=0) for p in points], axis=0)
    high = np.max([p.max(axis=0) for p in points], axis=0)
    centre = np.round(0.5 * (low + high), 2)
    return centre, float(np.ceil(50.0 * np.linalg.norm(high - low)) / 100.0 + 0.02)
