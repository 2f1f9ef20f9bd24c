"""What every `HandMotion` must do."""

from __future__ import annotations

from collections.abc import Callable

import numpy as np

from clothrf_core.interfaces import HandMotion


def check_hands(
    make: Callable[[], HandMotion],
    *,
    max_distance: float = 0.30,
    max_speed: float = 0.10,
    seconds: float = 60.0,
    dt: float = 1.0 / 30.0,
    seed: int = 0,
) -> None:
    """Same generator, same motion; hands keep their distance and their speed at every step.

    Args:
        make: builds the motion.
        max_distance: largest distance of the two hands, m.
        max_speed: largest speed per axis, m/s.
        seconds: how long to watch, simulated.
        dt: length of a step, s.
        seed: of the motion watched.

    Raises:
        AssertionError: a promise is broken; the message names the time.
    """
    first, second = make(), make()
    for restart in range(2):
        hands = first.reset(np.random.default_rng(seed + restart))
        again = second.reset(np.random.default_rng(seed + restart))
        for index in range(round(seconds / dt)):
            when = f"after {index * dt:.3f} s"
            assert hands.shape == (2, 3), f"{when}: expected (2, 3) hands, got {hands.shape}"
            assert np.isfinite(hands).all(), f"{when}: hands are not finite"
            assert np.array_equal(hands, again), f"{when}: the same generator moved otherwise"
            distance = float(np.linalg.norm(hands[1] - hands[0]))
            assert distance <= max_distance * (1.0 + 1e-9), (
                f"{when}: hands are {distance:.6f} m apart, allowed are {max_distance} m"
            )
            before, hands = np.array(hands), first.step(dt)
            again = second.step(dt)
            speed = float(np.abs(hands - before).max()) / dt
            assert speed <= max_speed * (1.0 + 1e-6), (
                f"{when}: a hand moves at {speed:.6f} m/s, allowed are {max_speed} m/s"
            )
    # What is handed out belongs to the caller.
    given = first.reset(np.random.default_rng(seed))
    if given.flags.writeable:
        given += 1.0
    fresh = second.reset(np.random.default_rng(seed))
    moved = first.step(dt)
    assert np.array_equal(moved, second.step(dt)), "writing into a returned pose changed the motion"
    assert fresh.shape == (2, 3)
