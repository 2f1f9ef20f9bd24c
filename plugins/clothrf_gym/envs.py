"""The ids that Gymnasium knows. Importing this module registers them: that is Gymnasium's own way.

``gymnasium.make("clothrf_gym.envs:ClothRF/Straight-v0")`` imports it by itself.
"""

from __future__ import annotations

from gymnasium.envs.registration import register

TASKS = ("Straight", "Bent", "Twisted")

for _task in TASKS:
    register(
        id=f"ClothRF/{_task}-v0",
        entry_point="clothrf_gym.environment:ClothEnv",
        max_episode_steps=300,
        kwargs={"task": _task.lower()},
    )
