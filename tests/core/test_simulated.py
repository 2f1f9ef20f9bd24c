import dataclasses

import numpy as np

from clothrf_core import compose, config
from clothrf_core.params import HandNoise
from clothrf_core.scene import Label
from clothrf_core.simulated import Disturbance, SimulatedWorld
from clothrf_core.testing.fakes import CirclingHands, NoRandomizer, OffsetExpert, SheetSimulator
from clothrf_core.types import RobotCommand


class NoisyHands(NoRandomizer):
    def draw(self, rng, nominal):
        return dataclasses.replace(nominal, hand_noise=HandNoise(std=0.005, time_constant_s=0.3))


def world(toy, toy_experiment, randomizer=None):
    resolved = config.load(toy_experiment, toy)
    rig = resolved.rig
    return SimulatedWorld(
        SheetSimulator(),
        CirclingHands(rig.rest_hands),
        randomizer or NoRandomizer(),
        rig,
        resolved.experiment.cloth,
        1 / 30,
    )


def hold(state):
    return RobotCommand(0, 0, 0.1, np.array(state.grasp))


def test_the_robot_starts_where_the_expert_wants_it(toy, toy_experiment):
    state = world(toy, toy_experiment).reset(np.random.SeedSequence(1), OffsetExpert())
    assert np.allclose(state.grasp, state.hands + [-0.3, 0.0, 0.0])


def test_equal_seeds_start_equal_worlds(toy, toy_experiment):
    first, second = world(toy, toy_experiment), world(toy, toy_experiment)
    a = first.reset(np.random.SeedSequence(1), OffsetExpert())
    b = second.reset(np.random.SeedSequence(1), OffsetExpert())
    assert np.array_equal(a.vertices, b.vertices)


def test_the_scene_holds_cloth_hands_grippers_and_table(toy, toy_experiment):
    one = world(toy, toy_experiment)
    one.reset(np.random.SeedSequence(1), OffsetExpert())
    labels = [mesh.label for mesh in one.scene().meshes]
    assert sorted(labels) == sorted(
        [Label.CLOTH, Label.HAND, Label.HAND, Label.GRIPPER, Label.GRIPPER, Label.TABLE]
    )


def test_hands_touch_the_cloth_at_its_corners(toy, toy_experiment):
    one = world(toy, toy_experiment)
    state = one.reset(np.random.SeedSequence(1), OffsetExpert())
    held = [m for m in one.scene().meshes if m.label in (Label.HAND, Label.GRIPPER)]
    for mesh, corner in zip(held, [*state.hands, *state.grasp], strict=True):
        assert np.linalg.norm(mesh.vertices - corner, axis=1).min() < 0.015


def test_noise_of_the_hands_has_its_deviation_and_memory(toy, toy_experiment):
    noisy, calm = world(toy, toy_experiment, NoisyHands()), world(toy, toy_experiment)
    offsets = []
    for one in (noisy, calm):
        one.reset(np.random.SeedSequence(5), OffsetExpert())
    for _ in range(6000):
        for one in (noisy, calm):
            one.advance(hold(one.state))
        offsets.append(noisy.state.hands - calm.state.hands)
    x = np.array(offsets).reshape(len(offsets), -1)
    assert 0.0045 < x.std() < 0.0055
    correlation = (x[1:] * x[:-1]).mean() / (x**2).mean()
    assert abs(correlation - np.exp(-(1 / 30) / 0.3)) < 0.02


def test_a_disturbance_has_its_deviation(rng):
    disturbance = Disturbance(0.02, 1 / 30)
    x = [np.zeros((2, 3))]
    for _ in range(8000):
        x.append(disturbance.next(x[-1], rng))
    assert 0.018 < np.std(x[100:]) < 0.022


def test_arrivals_count_what_the_hands_reached(toy, toy_experiment):
    one = world(toy, toy_experiment)
    one.reset(np.random.SeedSequence(1), OffsetExpert())
    assert one.arrivals == 0
    for _ in range(60):
        one.advance(hold(one.state))
    assert one.arrivals == 4


def test_a_workshop_builds_every_part_from_the_config(toy, toy_experiment):
    shop = compose.workshop(config.load(toy_experiment, toy), toy)
    assert list(shop.experts) == ["ahead"]
    assert len(shop.extractor.names) == 48


def test_a_start_from_rest_is_near_the_rest_corners_and_within_reach(toy, toy_experiment):
    one = world(toy, toy_experiment)
    rest = config.load(toy_experiment, toy).rig.rest_grasp
    for seed in range(20):
        state = one.reset(np.random.SeedSequence(seed), OffsetExpert(), from_rest=1.0)
        assert np.abs(state.grasp - rest).max() < 0.05 + 0.08
        assert np.linalg.norm(state.grasp - state.hands, axis=1).max() <= 0.98 * 0.35 + 1e-9


def test_a_share_of_rollouts_starts_from_rest(toy, toy_experiment):
    one = world(toy, toy_experiment)
    wanted = [
        one.reset(np.random.SeedSequence(seed), OffsetExpert(), from_rest=0.5) for seed in range(60)
    ]
    at_expert = [np.allclose(s.grasp, s.hands + [-0.3, 0.0, 0.0]) for s in wanted]
    assert 18 < sum(at_expert) < 42
