"""Motions of the four corners that the benchmark pulls the cloth through."""

from __future__ import annotations

import numpy as np

from clothrf_core.types import Float

WIDTH, LENGTH = 0.30, 0.35
STEP = 1.0 / 30.0
REST = np.array([[0.655, -0.15, 0.279], [0.609, 0.15, 0.309]])
TASKS = ("straight", "bent", "twisted", "stress")


def motion(task: str, steps: int, seed: int) -> tuple[Float, Float]:
    """(steps, 2, 3) hands and (steps, 2, 3) grasp, one a control step, world.

    Hands wander between targets within 0.1 m of their rest, at most 0.1 m/s an axis and 0.30 m
    apart; the robot follows its expert at no more than 0.75 m/s. ``stress`` twists the cloth past
    180 degrees both ways while its width and length shrink and grow.
    """
    if task == "stress":
        return _stress(steps)
    hands = _wander(np.random.default_rng(seed), steps)
    grasp = [_expert(task, hands[0])]
    for h in hands[1:]:
        way = _expert(task, h) - grasp[-1]
        distance = np.linalg.norm(way, axis=1, keepdims=True)
        grasp.append(grasp[-1] + way * np.minimum(1.0, 0.75 * STEP / np.maximum(distance, 1e-12)))
    return hands, np.array(grasp)


def _wander(rng: np.random.Generator, steps: int) -> Float:
    def draw() -> Float:
        while True:
            hands: Float = REST + rng.uniform(-0.1, 0.1, (2, 3))
            if np.linalg.norm(hands[1] - hands[0]) <= WIDTH:
                return hands

    here = draw()
    path: list[Float] = []
    while len(path) < steps:
        goal = draw()
        count = int(np.ceil(np.abs(goal - here).max() / (0.1 * STEP)))
        path += [here + (goal - here) * k / count for k in range(count)]
        here = goal
    hands = np.array(path[:steps])
    half = 0.5 * (hands[:, 1] - hands[:, 0])
    middle = hands.mean(axis=1)
    apart = np.linalg.norm(half, axis=1, keepdims=True)
    half = half * np.minimum(1.0, 0.5 * WIDTH / apart)
    return np.stack([middle - half, middle + half], axis=1)


def _expert(task: str, hands: Float) -> Float:
    d = hands[1] - hands[0]
    c = np.cross(d, [0.0, 0.0, 1.0])
    c *= -np.sign(c[0]) / np.linalg.norm(c)
    if task == "straight":
        return hands + LENGTH * c
    if task == "bent":
        return hands + 0.5 * LENGTH * c
    n = np.cross(d, c)
    n /= np.linalg.norm(n)
    apart = float(np.linalg.norm(d))
    middle = hands.mean(axis=0) + np.sqrt(LENGTH**2 - apart**2 / 2.0) * c
    return np.stack([middle + 0.5 * apart * n, middle - 0.5 * apart * n])


def _stress(steps: int) -> tuple[Float, Float]:
    t = np.arange(steps) * STEP
    angle = 1.15 * np.pi * np.sin(2.0 * np.pi * t / 40.0)
    hand_half = 0.10 + 0.04 * np.cos(2.0 * np.pi * t / 12.0)
    grasp_half = 0.10 + 0.04 * np.cos(2.0 * np.pi * t / 15.0 + 1.0)
    apart = 0.22 + 0.06 * np.sin(2.0 * np.pi * t / 9.0)
    hands, grasp = np.zeros((steps, 2, 3)), np.zeros((steps, 2, 3))
    for i, side in enumerate((-1.0, 1.0)):
        turned = (np.cos(0.5 * angle), np.sin(0.5 * angle))
        hands[:, i] = np.stack([0.6 + 0 * t, *(side * hand_half * k for k in turned)], axis=1)
        back = (turned[0], -turned[1])
        grasp[:, i] = np.stack([0.6 - apart, *(side * grasp_half * k for k in back)], axis=1)
    return hands + [0.0, 0.0, 0.35], grasp + [0.0, 0.0, 0.35]
