"""Hands that follow a script, or stay still; nothing about them is random."""

from __future__ import annotations

import numpy as np
from typing_extensions import override

from clothrf_core.errors import ConfigError
from clothrf_core.interfaces import HandMotion
from clothrf_core.types import Float
from clothrf_tasks.config import ScriptedConfig, StillConfig
from clothrf_tasks.hand_limits import HandLimits


class Scripted(HandMotion):
    """Straight lines between timed poses.

    Attributes:
        times: (P,) float64 rising from 0, s.
        poses: (P, 2, 3) float64, world, m.
        repeat: start again after the last pose instead of staying there.
    """

    def __init__(self, times: Float, poses: Float, *, repeat: bool = False) -> None:
        self.times = times
        self.poses = poses
        self.repeat = repeat
        self._time = 0.0

    @property
    @override
    def arrivals(self) -> int:
        if self.repeat and len(self.times) > 1:
            rounds, rest = divmod(self._time, float(self.times[-1]))
            passed = int(np.searchsorted(self.times, rest, side="right")) - 1
            return int(rounds) * (len(self.times) - 1) + passed
        return int(np.searchsorted(self.times, self._time, side="right")) - 1

    @override
    def reset(self, rng: np.random.Generator) -> Float:
        self._time = 0.0
        return self.at(0.0)

    @override
    def step(self, dt: float) -> Float:
        self._time += dt
        return self.at(self._time)

    def at(self, time_s: float) -> Float:
        """(2, 3) hands at `time_s`."""
        if len(self.times) == 1:
            return np.array(self.poses[0])
        if self.repeat:
            time_s %= float(self.times[-1])
        t = min(max(time_s, 0.0), float(self.times[-1]))
        i = min(int(np.searchsorted(self.times, t, side="right")) - 1, len(self.times) - 2)
        share = (t - self.times[i]) / (self.times[i + 1] - self.times[i])
        result: Float = (1.0 - share) * self.poses[i] + share * self.poses[i + 1]
        return result


def build_scripted(config: ScriptedConfig, limits: HandLimits) -> Scripted:
    """The motion of a script, checked against the limits.

    Poses relative to the rest corners start from the rest corners drawn together to the largest
    legal distance.

    Raises:
        ConfigError: times do not rise from 0, or a pose or a way breaks a limit.
    """
    times = np.array([pose.time_s for pose in config.poses], float)
    poses = np.array([pose.hands for pose in config.poses], float)
    if config.frame == "rest":
        poses = poses + limits.drawn_together(limits.rest)
    if times[0] != 0.0 or np.any(np.diff(times) <= 0.0):
        raise ConfigError(
            f"hands.poses: expected time_s rising from 0, got {times.tolist()}; order the poses"
        )
    for time_s, pose in zip(times, poses, strict=True):
        if not limits.legal(pose):
            raise ConfigError(
                f"hands.poses at {time_s} s: expected uncrossed hands at most "
                f"{limits.max_distance} m apart, got {np.linalg.norm(pose[1] - pose[0]):.4f} m "
                f"apart at {pose.tolist()}; bring them together"
            )
    _check_speed(times, poses, limits)
    if config.repeat and not np.allclose(poses[0], poses[-1]):
        raise ConfigError(
            "hands.repeat: expected the last pose to equal the first, got "
            f"{poses[-1].tolist()} and {poses[0].tolist()}; add a pose that closes the loop"
        )
    return Scripted(times, poses, repeat=config.repeat)


def _check_speed(times: Float, poses: Float, limits: HandLimits) -> None:
    for i in range(len(times) - 1):
        speed = float(np.abs(poses[i + 1] - poses[i]).max() / (times[i + 1] - times[i]))
        if speed > limits.max_speed * (1.0 + 1e-9):
            raise ConfigError(
                f"hands.poses from {times[i]} to {times[i + 1]} s: expected at most "
                f"{limits.max_speed} m/s per axis, got {speed:.4f} m/s; allow more time"
            )


def build_still(config: StillConfig, limits: HandLimits) -> Scripted:
    """Hands that stay at a pose, or at the rest corners drawn together to a legal distance.

    Raises:
        ConfigError: the given pose is not legal.
    """
    if config.hands is None:
        pose = limits.drawn_together(limits.rest)
    else:
        pose = np.array(config.hands, float)
    if not limits.legal(pose):
        raise ConfigError(
            f"hands.hands: expected uncrossed hands at most {limits.max_distance} m apart, got "
            f"{pose.tolist()}; move them"
        )
    return Scripted(np.zeros(1), pose[None])
