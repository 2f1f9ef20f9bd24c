"""A cloth held by four corners as a Gymnasium environment.

The reward is the paper's section III: R(c) = -dist(O(c), O(c*)), with O(c*) the picture of the
same cloth under the same hands, but held by the expert: a second world that follows the expert.
"""

from __future__ import annotations

from pathlib import Path
from typing import Any

import gymnasium
import numpy as np
from numpy.random import SeedSequence
from numpy.typing import NDArray
from typing_extensions import override

from clothrf_core import compose, config
from clothrf_core.errors import ConfigError
from clothrf_core.locations import shipped
from clothrf_core.picture_distance import picture_distance
from clothrf_core.registry import Registry
from clothrf_core.scene import Picture
from clothrf_core.types import Observation, RobotCommand

Array = NDArray[np.float32]


class ClothEnv(gymnasium.Env[Array, Array]):
    """Move two grippers so that the picture becomes the wanted one.

    Observation: (F,) float32 features of the picture, as the forest sees them (zeros if the
    picture shows no cloth). Action: (6,) in [-1, 1], a share of the farthest step of each gripper
    per axis. Reward: minus the distance of the picture from the expert's, in [-1, 0]. ``info``
    holds ``grasp_error`` (m, from x*), ``distance`` and ``valid``.

    Args:
        task: straight, bent, twisted, or another of the experiment's tasks.
        experiment: TOML file; default: the shipped three tasks.
        render_mode: "rgb_array" or None.
    """

    metadata = {"render_modes": ["rgb_array"], "render_fps": 30}

    def __init__(
        self,
        task: str = "straight",
        experiment: str | Path | None = None,
        render_mode: str | None = None,
    ) -> None:
        registry = Registry.installed()
        path = Path(experiment) if experiment is not None else shipped("three_tasks.toml")
        resolved = config.load(path, registry)
        if task not in resolved.task_names:
            raise ConfigError(
                f"{path}: has no task '{task}'; it has {', '.join(resolved.task_names)}"
            )
        self.render_mode = render_mode
        self._task = task
        self._shop = compose.workshop(resolved, registry)
        self._ideal = compose.workshop(resolved, registry)
        self._reach = resolved.experiment.limits.max_speed * self._shop.limits.dt
        count = len(self._shop.extractor.names)
        self.observation_space = gymnasium.spaces.Box(-np.inf, np.inf, (count,), np.float32)
        self.action_space = gymnasium.spaces.Box(-1.0, 1.0, (6,), np.float32)
        self._picture: Picture | None = None
        self._sequence = 0

    @override
    def reset(
        self, *, seed: int | None = None, options: dict[str, Any] | None = None
    ) -> tuple[Array, dict[str, Any]]:
        super().reset(seed=seed)
        entropy = int(self.np_random.integers(2**62))
        for shop in (self._shop, self._ideal):
            shop.world.reset(SeedSequence(entropy), shop.experts[self._task])
        self._sequence = 0
        features, info = self._look()
        return features, info

    @override
    def step(self, action: Array) -> tuple[Array, float, bool, bool, dict[str, Any]]:
        here = np.asarray(self._shop.world.state.grasp)
        push = np.clip(np.asarray(action, float), -1.0, 1.0).reshape(2, 3) * self._reach
        low, high = self._shop.limits.section.low, self._shop.limits.section.high
        self._advance(self._shop, np.clip(here + push, low, high))
        ideal = self._ideal.experts[self._task].label(self._ideal.world.state)
        self._advance(self._ideal, np.asarray(ideal.targets))
        self._sequence += 1
        features, info = self._look()
        return features, -float(info["distance"]), False, False, info

    @override
    def render(self) -> NDArray[np.uint8] | None:
        if self.render_mode != "rgb_array" or self._picture is None:
            return None
        return np.array(self._picture.frame.rgb)

    def _advance(self, shop: compose.Workshop, targets: NDArray[np.float64]) -> None:
        shop.world.advance(RobotCommand(self._sequence, self._sequence, 1.0, targets))

    def _look(self) -> tuple[Array, dict[str, Any]]:
        shop = self._shop
        self._picture = shop.camera.picture()
        observation = Observation(shop.world.seen(self._picture), shop.world.grasp())
        features = shop.extractor.extract(observation)
        wanted = shop.experts[self._task].label(shop.world.state).targets
        info = {
            "grasp_error": float(np.linalg.norm(shop.world.state.grasp - wanted, axis=1).mean()),
            "distance": picture_distance(self._picture, self._ideal.camera.picture()),
            "valid": features.valid,
        }
        return np.array(features.values), info
