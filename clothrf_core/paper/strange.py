"""Pictures that no policy should trust: no cloth, a person's arm before it, another cloth."""

from __future__ import annotations

import dataclasses
from dataclasses import dataclass
from pathlib import Path
from typing import Literal

import numpy as np
from typing_extensions import override

from clothrf_core.compose import Workshop, cached_workshop
from clothrf_core.dataset import write_rollout
from clothrf_core.interfaces import RenderedCamera
from clothrf_core.opening import CameraAround
from clothrf_core.provider import BuildContext
from clothrf_core.registry import Registry
from clothrf_core.rollout import RolloutJob, roll_out
from clothrf_core.scene import Label, Picture, Scene, SceneMesh, capsule
from clothrf_core.simulated import SKIN, SimulatedCamera
from clothrf_core.types import CameraModel, Float, RgbdFrame

ARM_RADIUS, ARM_LENGTH = 0.045, 0.6  # m, a forearm and more of it than the picture holds

Change = Literal["no cloth", "arm", "as it is"]


class StrangeCamera(CameraAround, RenderedCamera):
    """A camera that draws a changed scene.

    Args:
        inner: what draws.
        change: what is changed.
        rng: where arms reach.
    """

    def __init__(self, inner: RenderedCamera, change: Change, rng: np.random.Generator) -> None:
        super().__init__(inner)
        self._inner = inner
        self._change = change
        self._rng = rng

    @override
    def read(self, timeout_s: float = 1.0) -> RgbdFrame:
        return self._inner.read(timeout_s)

    @override
    def render(self, scene: Scene, camera: CameraModel) -> Picture:
        meshes = scene.meshes
        if self._change == "no cloth":
            meshes = tuple(m for m in meshes if m.label != Label.CLOTH)
        elif self._change == "arm":
            meshes = (*meshes, arm(meshes, camera, self._rng))
        return self._inner.render(dataclasses.replace(scene, meshes=meshes), camera)


def arm(meshes: tuple[SceneMesh, ...], camera: CameraModel, rng: np.random.Generator) -> SceneMesh:
    """A forearm that reaches from a side of the picture over the cloth, nearer to the camera."""
    cloth = np.concatenate([m.vertices for m in meshes if m.label == Label.CLOTH])
    over = cloth[rng.integers(len(cloth))]
    eye = camera.T_world_camera[:3, 3]
    end = over + rng.uniform(0.15, 0.4) * (eye - over)
    angle = rng.uniform(0.0, 2.0 * np.pi)
    right, down = camera.T_world_camera[:3, 0], camera.T_world_camera[:3, 1]
    way: Float = np.cos(angle) * right + np.sin(angle) * down
    return capsule(end, end + ARM_LENGTH * way, ARM_RADIUS, Label.HAND, SKIN)


@dataclass(frozen=True, slots=True)
class StrangeJob:
    """A roll-out seen through a `StrangeCamera`.

    Attributes:
        rollout: the roll-out; its expert leads, undisturbed by what the camera sees.
        change: what is strange about it.
    """

    rollout: RolloutJob
    change: Change

    @property
    def name(self) -> str:
        """How messages call it."""
        return f"{self.change}, {self.rollout.name}"

    def run(self) -> str:
        """Do it unless the file is there; returns the file's path."""
        path = Path(self.rollout.out)
        if not path.exists():
            shop = _altered(cached_workshop(self.rollout.config), self.change, self.rollout)
            write_rollout(path, roll_out(shop, self.rollout, None))
        return self.rollout.out


def _altered(shop: Workshop, change: Change, job: RolloutJob) -> Workshop:
    """The same workshop with a changed view; world, robot and extractor are shared."""
    resolved = shop.resolved
    registry = Registry.installed()
    context = BuildContext(resolved.rig, shop.world, resolved.folder, registry)
    chosen = resolved.components["camera"]
    inner = registry.build(chosen.kind, chosen.plugin, chosen.options, context)
    rng = np.random.default_rng(np.random.SeedSequence(job.seed, spawn_key=(job.index,)))
    seen = SimulatedCamera(StrangeCamera(inner, change, rng), shop.world)
    return dataclasses.replace(shop, camera=seen)
