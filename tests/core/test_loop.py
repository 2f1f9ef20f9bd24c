import numpy as np

from clothrf_core import compose, config
from clothrf_core.limits import Limits, LimitsSection
from clothrf_core.loop import Controller, run
from clothrf_core.types import Action


class Watcher:
    def __init__(self):
        self.steps = []

    def on_step(self, step):
        self.steps.append(step)


class FixedPolicy:
    tasks = ("ahead",)

    def __init__(self, targets, confidence=1.0):
        self.action = Action(targets, confidence)

    def act(self, features, task):
        return self.action


class NothingSeen:
    """A camera whose every depth is missing."""

    def __init__(self, camera):
        self.camera = camera

    def __enter__(self):
        self.camera.__enter__()
        return self

    def __exit__(self, *error):
        self.camera.__exit__(*error)

    def read(self, timeout_s=1.0):
        import dataclasses

        frame = self.camera.read()
        return dataclasses.replace(frame, depth=np.full_like(frame.depth, np.nan))


def wired(toy, toy_experiment, policy, wrap=lambda camera: camera):
    shop = compose.workshop(config.load(toy_experiment, toy), toy)
    start = shop.world.reset(np.random.SeedSequence(3), shop.experts["ahead"])
    camera = wrap(shop.camera)
    limits = Limits(LimitsSection(), shop.limits.dt)
    return Controller(camera, shop.extractor, policy, limits, shop.robot, "ahead"), shop, start


def test_the_grippers_go_where_the_policy_says(toy, toy_experiment):
    goal = np.array([[0.36, -0.13, 0.33], [0.36, 0.15, 0.33]])
    controller, shop, _ = wired(toy, toy_experiment, FixedPolicy(goal))
    with controller.camera, controller.robot:
        run(controller, range(20))
    assert np.allclose(shop.world.state.grasp, goal)


def test_observers_see_every_turn_in_order(toy, toy_experiment):
    controller, _, _ = wired(toy, toy_experiment, FixedPolicy(np.zeros((2, 3))))
    watcher = Watcher()
    with controller.camera, controller.robot:
        assert run(controller, range(4), [watcher]) == 4
    assert [s.sequence for s in watcher.steps] == [0, 1, 2, 3]
    stamps = [s.observation.frame.stamp_ns for s in watcher.steps]
    assert stamps == [round(k * 1e9 / 30) for k in range(4)]


def test_a_picture_that_says_nothing_holds_the_arms(toy, toy_experiment):
    controller, shop, start = wired(toy, toy_experiment, FixedPolicy(np.ones((2, 3))), NothingSeen)
    watcher = Watcher()
    with controller.camera, controller.robot:
        run(controller, range(3), [watcher])
    assert np.array_equal(shop.world.state.grasp, start.grasp)
    assert all(not s.features.valid and s.sent.held for s in watcher.steps)


def test_the_frame_tells_the_nominal_camera_whatever_was_rendered(toy, toy_experiment):
    controller, shop, _ = wired(toy, toy_experiment, FixedPolicy(np.zeros((2, 3))))
    with controller.camera:
        frame = controller.camera.read()
    assert np.array_equal(frame.camera.K, shop.resolved.rig.camera.model().K)
