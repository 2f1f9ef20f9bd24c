from __future__ import annotations

import numpy as np
import pytest

from clothrf_core.params import Fabric
from clothrf_core.registry import Registry
from clothrf_core.testing.simulator import DT, GRASP, HANDS, check_simulator, params

pytest.importorskip("mujoco", reason="needs the extra 'mujoco'")

from clothrf_mujoco.config import FlexOptions
from clothrf_mujoco.simulator import FlexSimulator
from clothrf_mujoco.stepping import Stepper

REGISTRY = Registry.installed()


def seeded(seed: int = 0) -> np.random.Generator:
    return np.random.default_rng(seed)


def waved(step: int) -> tuple[np.ndarray, np.ndarray]:
    """Hands and grasp of a smooth legal motion."""
    t = step * DT
    lift = np.array([0.02 * np.sin(3 * t), 0.01 * np.sin(2 * t), 0.03 * np.sin(t)])
    return HANDS + lift, GRASP + lift[[2, 0, 1]]


def other() -> object:
    return REGISTRY.build("simulator", "sapien")


def test_the_simulator_keeps_every_promise_of_the_contract():
    check_simulator(lambda: REGISTRY.build("simulator", "mujoco"), strain=0.03)


def test_it_has_the_mesh_of_the_other_simulator():
    ours, theirs = FlexSimulator(FlexOptions()), other()
    ours.reset(seeded(), params())
    theirs.reset(seeded(), params())

    for key in ("triangles", "rest", "corners", "edges"):
        assert np.array_equal(getattr(ours.mesh(), key), getattr(theirs.mesh(), key)), key


def test_a_sheet_sags_like_the_other_simulator_s():
    p = params(resolution=(21, 24), settle_s=2.0)

    low = [s.reset(seeded(1), p).vertices for s in (FlexSimulator(FlexOptions()), other())]

    sag = [HANDS[0, 2] - x[:, 2].min() for x in low]
    assert sag[0] > 0.05
    assert sag[0] == pytest.approx(sag[1], abs=3e-3)
    assert np.sqrt(np.mean(np.sum((low[0] - low[1]) ** 2, axis=1))) < 5e-3


def test_the_same_motion_gives_the_other_simulator_s_vertices_within_5_mm():
    pair = FlexSimulator(FlexOptions()), other()
    for s in pair:
        s.reset(seeded(1), params(resolution=(21, 24)))
    apart = []
    for step in range(1, 60):
        hands, grasp = waved(step)
        x, y = (s.step(grasp, hands, DT).vertices for s in pair)
        apart.append(np.mean(np.sum((x - y) ** 2, axis=1)))

    assert np.sqrt(np.median(apart)) < 5e-3


def test_corners_that_move_are_where_they_were_told_and_as_fast():
    simulator = FlexSimulator(FlexOptions(substeps=3))
    simulator.reset(seeded(), params())
    hands, grasp = waved(1)

    state = simulator.step(grasp, hands, DT)

    corners = simulator.mesh().corners
    moved = np.concatenate([hands - HANDS, grasp - GRASP])
    assert np.array_equal(state.vertices[corners], np.concatenate([hands, grasp]))
    assert np.allclose(state.velocities[corners], moved / DT)


def test_another_fabric_between_two_resets_does_not_stay():
    simulator = FlexSimulator(FlexOptions())
    first = simulator.reset(seeded(3), params())
    heavy = simulator.reset(seeded(3), params(fabric=Fabric(density=0.6, bending=1e-3)))

    again = simulator.reset(seeded(3), params())

    assert np.abs(heavy.vertices - first.vertices).max() > 1e-3
    assert np.array_equal(first.vertices, again.vertices)


@pytest.mark.parametrize("reach", [0.05, 0.3, 2.0, 1e3])
@pytest.mark.parametrize("dt", [1e-4, 1 / 30, 0.2])
def test_whatever_the_corners_do_the_numbers_stay_finite_and_no_log_is_written(
    reach, dt, tmp_path, monkeypatch
):
    monkeypatch.chdir(tmp_path)
    rng = seeded(5)
    start = rng.uniform(-reach, reach, size=(4, 3))
    simulator = FlexSimulator(FlexOptions())
    simulator.reset(seeded(), params(hands=start[:2], grasp=start[2:], resolution=(5, 6)))

    for _ in range(6):
        corners = rng.uniform(-reach, reach, size=(4, 3))
        state = simulator.step(corners[2:], corners[:2], dt)
        assert np.isfinite(state.vertices).all()
        assert np.isfinite(state.velocities).all()
        assert np.array_equal(state.hands, corners[:2])
    assert list(tmp_path.iterdir()) == []


def test_a_step_that_runs_away_is_taken_back_and_the_shape_goes_with_its_corners(monkeypatch):
    simulator = FlexSimulator(FlexOptions())
    before = simulator.reset(seeded(), params()).vertices
    monkeypatch.setattr(Stepper, "_sane", lambda self, corners: False)

    state = simulator.step(GRASP + [0, 0, 0.01], HANDS + [0, 0, 0.01], DT)

    assert np.allclose(state.vertices, before + [0, 0, 0.01])
    free = np.delete(state.velocities, simulator.mesh().corners, axis=0)
    assert np.array_equal(free, np.zeros_like(free))
