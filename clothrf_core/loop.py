"""The control loop: seven rooms, one corridor. Read this file first.

Coordinates change in the features' room, units in the camera's, safety is added in `limits`, bytes
appear in the robot's. Simulation replaces the two ends and nothing in between.
"""

from __future__ import annotations

from collections.abc import Iterable, Sequence
from dataclasses import dataclass
from typing import Protocol

from clothrf_core.interfaces import Camera, FeatureExtractor, Policy, Robot
from clothrf_core.limits import Limits
from clothrf_core.types import Action, Features, GraspState, Observation, RobotCommand


@dataclass(frozen=True, slots=True)
class Step:
    """One turn of the loop, as observers see it."""

    sequence: int
    observation: Observation
    features: Features
    action: Action
    sent: RobotCommand


class Observer(Protocol):
    """Watches the loop: a recorder, a live line, a plot."""

    def on_step(self, step: Step) -> None:
        """Called after each command was sent; must be quick."""


@dataclass(frozen=True, slots=True)
class Controller:
    """The parts of a loop, wired."""

    camera: Camera
    extractor: FeatureExtractor
    policy: Policy
    limits: Limits
    robot: Robot
    task: str

    def step(self, sequence: int) -> Step:
        """See, think, limit, act."""
        observation = Observation(self.camera.read(), self.robot.state())
        features = self.extractor.extract(observation)
        action = decide(self.policy, features, self.task, observation.grasp)
        command = self.limits.command(action, observation, sequence)
        sent = self.robot.send(command)
        return Step(sequence, observation, features, action, sent)


def decide(policy: Policy, features: Features, task: str, grasp: GraspState) -> Action:
    """What the policy wants, or staying at `grasp` when the picture says nothing."""
    return policy.act(features, task) if features.valid else Action.hold(grasp)


def run(
    controller: Controller, sequences: Iterable[int], observers: Sequence[Observer] = ()
) -> int:
    """Run the loop over `sequences` (see `clock.ticks`); returns the number of turns.

    Camera and robot must be entered by the caller (``with camera, robot:``), whose exit stops
    the arms whatever happened in here.
    """
    count = 0
    for sequence in sequences:
        step = controller.step(sequence)
        for observer in observers:
            observer.on_step(step)
        count += 1
    return count
