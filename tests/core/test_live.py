import numpy as np
import pytest

from clothrf_core import config, live
from clothrf_core.clock import ManualClock
from clothrf_core.errors import ConfigError
from clothrf_core.types import Action, GraspState


class Towards:
    tasks = ("ahead",)

    def __init__(self, targets):
        self.targets = targets

    def act(self, features, task):
        return Action(self.targets)


class OtherRobot:
    """A robot that is not the simulated one: it reaches each command at once."""

    def __init__(self, positions, log):
        self.positions, self.log = positions, log

    def __enter__(self):
        self.log.append("robot entered")
        return self

    def __exit__(self, *error):
        self.log.append("robot stopped")

    def state(self):
        return GraspState(np.array(self.positions), 0)

    def send(self, command):
        self.positions = np.array(command.targets)
        return command

    def status(self):
        return {"bridge": "RUNNING", "why": "", "age_ms": 1.234567}


GOAL = np.array([[0.36, -0.13, 0.33], [0.36, 0.15, 0.33]])


def test_a_simulated_session_runs_for_its_time(toy, toy_experiment):
    resolved = config.load(toy_experiment, toy)
    session = live.session(resolved, toy, Towards(GOAL), "ahead")
    pulse = live.Pulse()
    turns = session.run(seconds=0.49, observers=(pulse,), clock=ManualClock())
    assert turns == pulse.turns == 15
    assert np.allclose(session.controller.robot.state().positions, GOAL)


def test_an_unknown_task_is_named_with_those_known(toy, toy_experiment):
    resolved = config.load(toy_experiment, toy)
    with pytest.raises(ConfigError, match="no task 'ahed' in this policy. Did you mean 'ahead'?"):
        live.session(resolved, toy, Towards(GOAL), "ahed")


def test_in_a_rehearsal_the_cloth_hangs_on_the_robots_grippers(toy, toy_experiment, monkeypatch):
    log = []
    robot = OtherRobot(GOAL + 0.02, log)
    monkeypatch.setattr(live.compose, "robot", lambda *_: robot)
    text = toy_experiment.read_text() + '\n[robot]\nplugin = "other"\n'
    toy_experiment.write_text(text)
    from types import ModuleType

    import clothrf_toy

    from clothrf_core import builtin
    from clothrf_core.hookspecs import hookimpl
    from clothrf_core.provider import Provider
    from clothrf_core.registry import Registry

    module = ModuleType("other")

    def clothrf_robots():
        return [Provider("other", "another", lambda config, context: robot)]

    module.clothrf_robots = hookimpl(clothrf_robots)
    registry = Registry.of(builtin, clothrf_toy, module)
    session = live.session(config.load(toy_experiment, registry), registry, Towards(GOAL), "ahead")
    world = session.controller.camera._world
    session.run(seconds=0.4, clock=ManualClock())
    assert np.allclose(robot.positions, GOAL)
    assert np.allclose(world.state.grasp, GOAL, atol=1e-9)
    assert log == ["robot entered", "robot stopped"]


def test_the_robot_stops_even_if_the_loop_fails(toy, toy_experiment):
    log = []
    resolved = config.load(toy_experiment, toy)
    session = live.session(resolved, toy, Towards(GOAL), "ahead")
    parts = session.controller
    broken = live.Controller(
        parts.camera, None, parts.policy, parts.limits, OtherRobot(GOAL, log), "ahead"
    )
    with pytest.raises(AttributeError):
        live.Session(broken, 30.0, paced_by_camera=False).run(seconds=1.0, clock=ManualClock())
    assert log == ["robot entered", "robot stopped"]


def test_the_live_line_tells_rate_confidence_and_bridge():
    line = live.live_line(live.Pulse(), OtherRobot(GOAL, []))
    assert "0.0 Hz" in line
    assert "bridge RUNNING  age_ms 1.23" in line
    assert "why" not in line


def test_the_pulse_measures_rate_and_jitter():
    pulse = live.Pulse(stamps_ns=[round(k * 1e9 / 30) for k in range(31)])
    assert abs(pulse.rate_hz - 30.0) < 1e-6
    assert pulse.jitter_ms < 1e-5
