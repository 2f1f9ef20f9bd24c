"""What every `Expert` must do."""

from __future__ import annotations

from collections.abc import Callable

import numpy as np

from clothrf_core.interfaces import Expert
from clothrf_core.types import ClothState, Float


def check_expert(
    make: Callable[[], Expert],
    *,
    length: float = 0.35,
    stretch: float = 1e-9,
    max_distance: float = 0.30,
    seed: int = 0,
) -> None:
    """Labels are finite, pure, and never pull a side edge beyond its length.

    Args:
        make: builds the expert.
        length: of the cloth between hand and grasp, m.
        stretch: how much longer than `length` a side edge may be asked to be, as a share.
        max_distance: of the hands in the poses tried, m.
        seed: of the poses tried.

    Raises:
        AssertionError: a promise is broken; the message names the hands.
    """
    expert, twin = make(), make()
    states = [
        cloth_state(hands) for hands in legal_hands(np.random.default_rng(seed), max_distance)
    ]
    labels = [expert.label(state).targets for state in states]
    for state, targets in zip(states, labels, strict=True):
        where = f"hands {state.hands.tolist()}"
        assert targets.shape == (2, 3), f"{where}: expected (2, 3) targets, got {targets.shape}"
        assert np.isfinite(targets).all(), f"{where}: the label is not finite"
        sides = np.linalg.norm(targets - state.hands, axis=1)
        assert sides.max() <= length * (1.0 + stretch), (
            f"{where}: a side edge of {length} m is asked to be {sides.max():.6f} m long"
        )
    # Another order and another instance give the same labels: no hidden memory.
    for state, targets in reversed(list(zip(states, labels, strict=True))):
        assert np.array_equal(twin.label(state).targets, targets), (
            f"hands {state.hands.tolist()}: the label depends on the states seen before"
        )


def cloth_state(hands: Float, *, grasp: Float | None = None, time_s: float = 0.0) -> ClothState:
    """A state with the given corners and no cloth between them.

    Args:
        hands: (2, 3) float64, world, m.
        grasp: (2, 3) float64, world, m; by default 0.3 m nearer to the robot than the hands.
        time_s: simulated time.
    """
    nearer = np.asarray(hands, float) + np.array([-0.3, 0.0, 0.1])
    grasp = nearer if grasp is None else np.asarray(grasp, float)
    return ClothState(
        vertices=np.concatenate([hands, grasp]).astype(float),
        velocities=np.zeros((4, 3)),
        hands=np.array(hands, float),
        grasp=grasp,
        time_s=time_s,
    )


def legal_hands(rng: np.random.Generator, max_distance: float = 0.30) -> list[Float]:
    """(2, 3) hand poses: random ones, and the awkward ones (stacked, touching, level)."""
    middle = np.array([0.63, 0.0, 0.29])
    half = 0.4999 * max_distance
    ways = [[0, 1, 0], [1, 0, 0], [0, 0, 1], [0, 0, -1], [0, 1e-9, 1], [0, 1e-3, 0.5]]
    ways += [[0, 0, 0], [0, 1e-9, 0], [1e-7, 0, 0]]
    ways += list(rng.normal(size=(64, 3)))
    poses = []
    for way in np.array(ways, float):
        d = half * way / max(1.0, float(np.linalg.norm(way)))
        centre = middle + rng.uniform(-0.1, 0.1, size=3)
        poses.append(np.stack([centre - d, centre + d]))
    return poses
