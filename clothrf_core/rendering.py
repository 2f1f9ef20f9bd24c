"""What every rendered camera shares: reading frames of the world that it looks at."""

from __future__ import annotations

from collections.abc import Callable

from clothrf_core.clock import Clock, WallClock
from clothrf_core.errors import ConfigError, StaleFrame
from clothrf_core.interfaces import World
from clothrf_core.scene import Picture, Scene
from clothrf_core.types import CameraModel, RgbdFrame

POLL_NS = 1_000_000


class WorldReader:
    """Turns `render` into `read`: waits until the world shows a later instant, then draws it.

    Args:
        name: of the camera, for messages.
        world: what it looks at; None for a camera that only renders.
        render: draws a scene.
        clock: to wait with.
    """

    def __init__(
        self,
        name: str,
        world: World | None,
        render: Callable[[Scene, CameraModel], Picture],
        clock: Clock | None = None,
    ) -> None:
        self._name = name
        self._world = world
        self._render = render
        self._clock = clock or WallClock()
        self._last_ns: int | None = None

    def restart(self) -> None:
        """Forget the last stamp; for a camera that is opened anew."""
        self._last_ns = None

    def read(self, timeout_s: float) -> RgbdFrame:
        """The frame of the next instant.

        Raises:
            StaleFrame: the world did not advance within `timeout_s`.
            ConfigError: there is no world to look at.
        """
        if self._world is None:
            raise ConfigError(
                f"camera '{self._name}' has no world to look at: build it with "
                "BuildContext(world=...), or draw a scene with render(scene, camera)"
            )
        deadline = self._clock.now_ns() + round(timeout_s * 1e9)
        scene = self._world.scene()
        while self._last_ns is not None and scene.stamp_ns <= self._last_ns:
            now = self._clock.now_ns()
            if now >= deadline:
                raise StaleFrame(
                    f"camera '{self._name}': expected a frame later than {self._last_ns} ns "
                    f"within {timeout_s} s, the world still shows {scene.stamp_ns} ns; "
                    "advance it between two reads"
                )
            self._clock.sleep_until_ns(min(now + POLL_NS, deadline))
            scene = self._world.scene()
        picture = self._render(scene, self._world.camera_model())
        self._last_ns = scene.stamp_ns
        return picture.frame
