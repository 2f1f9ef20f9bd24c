"""How far, how fast and how hard the joints may move: two profiles."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from clothrf_core.errors import ConfigError
from clothrf_core.types import Float
from clothrf_yumi.irb14000 import AXES

SOFT_MARGIN_DEG = 2.0


@dataclass(frozen=True, slots=True)
class Profile:
    """Bounds of motion; ABB publishes none for acceleration and jerk.

    Each pair is for the four axes of shoulder and elbow (1, 2, 7, 3) and the three of the wrist.

    Attributes:
        speed_share: of the controller's joint speeds.
        speed: rad/s, in addition.
        cruise: acceleration while following targets, rad/s^2.
        stop: acceleration while stopping, rad/s^2.
        jerk: rad/s^3.
    """

    speed_share: float
    speed: tuple[float, float]
    cruise: tuple[float, float]
    stop: tuple[float, float]
    jerk: tuple[float, float]


# Normal: a stop from full profile speed takes 0.1 s; 10 rad/s^2 and 1000 rad/s^3 are what other
# arms of this size are driven with. Commissioning: slow enough to watch and to reach the button.
PROFILES = {
    "normal": Profile(0.5, (np.inf, np.inf), (10.0, 20.0), (25.0, 60.0), (1000.0, 2500.0)),
    "commissioning": Profile(1.0, (0.2, 0.2), (2.0, 2.0), (4.0, 4.0), (40.0, 40.0)),
}


@dataclass(frozen=True, slots=True, eq=False)
class Limits:
    """Implements `JointLimits`; (14,) float64 arrays, radians and seconds.

    Attributes:
        cruise: acceleration while following targets; `acceleration` bounds stops too.
    """

    lower: Float
    upper: Float
    soft_lower: Float
    soft_upper: Float
    velocity: Float
    acceleration: Float
    jerk: Float
    cruise: Float

    @staticmethod
    def of(name: str) -> Limits:
        """The limits of both arms in the profile `name`.

        Raises:
            ConfigError: no such profile.
        """
        if name not in PROFILES:
            raise ConfigError(
                f"arm.profile: expected one of {', '.join(sorted(PROFILES))}, got '{name}'"
            )
        profile = PROFILES[name]
        lower = _both([np.radians(axis.lower) for axis in AXES])
        upper = _both([np.radians(axis.upper) for axis in AXES])
        speed = _both([np.radians(axis.speed) for axis in AXES])
        margin = np.radians(SOFT_MARGIN_DEG)
        return Limits(
            lower=lower,
            upper=upper,
            soft_lower=_frozen(lower + margin),
            soft_upper=_frozen(upper - margin),
            velocity=_frozen(np.minimum(profile.speed_share * speed, _groups(profile.speed))),
            acceleration=_groups(profile.stop),
            jerk=_groups(profile.jerk),
            cruise=_groups(profile.cruise),
        )


def _groups(pair: tuple[float, float]) -> Float:
    return _both([pair[0]] * 4 + [pair[1]] * 3)


def _both(arm: list[float]) -> Float:
    return _frozen(np.array(arm + arm))


def _frozen(values: Float) -> Float:
    values.setflags(write=False)
    return values
