"""Pictures of a roll-out for people: what the camera saw, what was wanted, what was done."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from clothrf_core.camera_model import project
from clothrf_core.compose import Workshop
from clothrf_core.geometry import look_at
from clothrf_core.interfaces import Policy
from clothrf_core.loop import decide
from clothrf_core.rollout import stream
from clothrf_core.scene import Picture
from clothrf_core.types import CameraModel, Float, Observation

WANTED, DONE = (242, 140, 40), (60, 200, 120)
Image = NDArray[np.uint8]


@dataclass(frozen=True, slots=True)
class Shot:
    """One drawn instant of a roll-out: the robot camera's view and one from the side."""

    camera: Image
    side: Image
    error_mm: float


def film(
    shop: Workshop,
    policy: Policy | None,
    task: str,
    *,
    seed: int,
    index: int,
    steps: int,
    every: int,
) -> list[Shot]:
    """Draw every `every`-th step of an episode in which one controller acts alone.

    The hands move the same for the same `index`, whoever acts; the expert acts without a policy.
    """
    expert = shop.experts[task]
    shop.world.reset(stream(seed, "episode", 0, index), expert)
    side = side_camera(shop)
    shots: list[Shot] = []
    with shop.camera, shop.robot:
        for sequence in range(steps):
            truth = expert.label(shop.world.state)
            picture = shop.camera.picture()
            observation = Observation(shop.world.seen(picture), shop.robot.state())
            action = truth
            if policy is not None:
                features = shop.extractor.extract(observation)
                action = decide(policy, features, task, observation.grasp)
            if sequence % every == 0:
                shots.append(_shot(shop, picture, side, truth.targets, observation))
            shop.robot.send(shop.limits.command(action, observation, sequence))
    return shots


def _shot(
    shop: Workshop, picture: Picture, side: CameraModel, wanted: Float, observation: Observation
) -> Shot:
    views = []
    for image, camera in (
        (picture.frame.rgb, picture.frame.camera),
        (shop.camera.draw(side).frame.rgb, side),
    ):
        marked = np.array(image)
        mark(marked, project(camera, wanted)[0], WANTED, size=9)
        mark(marked, project(camera, observation.grasp.positions)[0], DONE, size=5)
        views.append(marked)
    error = float(np.linalg.norm(observation.grasp.positions - wanted, axis=1).mean())
    return Shot(views[0], views[1], 1e3 * error)


def side_camera(shop: Workshop) -> CameraModel:
    """A camera beside the cloth that sees hands, cloth and grippers; for people only."""
    rig = shop.resolved.rig
    middle = np.concatenate([rig.rest_hands, rig.rest_grasp]).mean(axis=0)
    middle = middle - np.array([0.08, 0.0, 0.05])
    eye = middle + np.array([0.45, -0.75, 0.35])
    width, height = rig.camera.width, rig.camera.height
    f = 1.35 * width
    K = np.array([[f, 0.0, 0.5 * (width - 1)], [0.0, f, 0.5 * (height - 1)], [0.0, 0.0, 1.0]])
    return CameraModel(width, height, K, look_at(eye, middle), near=0.1, far=3.0)


def mark(image: Image, pixels: Float, colour: tuple[int, int, int], *, size: int) -> None:
    """Draw crosses of `size` pixels into (H, W, 3) `image` at (N, 2) pixels, in place."""
    h, w = image.shape[:2]
    for u, v in pixels[np.isfinite(pixels).all(axis=1)]:
        for offset in range(-size, size + 1):
            for x, y in ((u + offset, v + offset), (u + offset, v - offset)):
                for thick in (0, 1):
                    column, row = round(x) + thick, round(y)
                    if 0 <= column < w and 0 <= row < h:
                        image[row, column] = colour


def beside(left: list[Shot], right: list[Shot]) -> list[Image]:
    """Two films side by side, seen from the side, halved in size."""
    return [
        halved(np.concatenate([a.side, b.side], axis=1)) for a, b in zip(left, right, strict=False)
    ]


def contact_sheet(shots: list[Shot], *, columns: int = 3) -> Image:
    """Camera and side views of up to `columns` instants, evenly spread, as one picture."""
    chosen = [shots[i] for i in np.linspace(0, len(shots) - 1, columns).astype(int)]
    rows = [
        np.concatenate([s.camera for s in chosen], axis=1),
        np.concatenate([s.side for s in chosen], axis=1),
    ]
    return halved(np.concatenate(rows, axis=0))


def halved(image: Image) -> Image:
    """Every 2 x 2 block of an image as its mean."""
    h, w = image.shape[0] // 2, image.shape[1] // 2
    blocks = image[: 2 * h, : 2 * w].reshape(h, 2, w, 2, 3)
    small: Image = blocks.mean(axis=(1, 3)).astype(np.uint8)
    return small
