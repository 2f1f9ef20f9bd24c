"""What both cloth simulators must survive or refuse; the promises to everybody are the contract's.

Scenarios that a single simulator has a reason to fear stand beside its plugin's other tests.
"""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest

from clothrf_core.errors import ClothrfError, ConfigError, MissingDependency, ShapeError
from clothrf_core.interfaces import Simulator
from clothrf_core.params import Fabric
from clothrf_core.registry import Registry
from clothrf_core.testing.simulator import DT, GRASP, HANDS, params

REGISTRY = Registry.installed()


@pytest.fixture(params=["sapien", "mujoco"])
def simulator(request: pytest.FixtureRequest) -> Simulator:
    try:
        return REGISTRY.build("simulator", request.param)
    except MissingDependency as error:
        pytest.skip(str(error))


def seeded(seed: int = 0) -> np.random.Generator:
    return np.random.default_rng(seed)


def waved(step: int) -> tuple[np.ndarray, np.ndarray]:
    """Hands and grasp of a smooth legal motion."""
    t = step * DT
    lift = np.array([0.02 * np.sin(3 * t), 0.01 * np.sin(2 * t), 0.03 * np.sin(t)])
    return HANDS + lift, GRASP + lift[[2, 0, 1]]


def strains(state, mesh) -> np.ndarray:
    i, j = mesh.edges.T
    now = np.linalg.norm(state.vertices[i] - state.vertices[j], axis=1)
    return now / np.linalg.norm(mesh.rest[i] - mesh.rest[j], axis=1) - 1


def test_a_second_reset_forgets_everything(simulator):
    first = simulator.reset(seeded(3), params())
    for step in range(1, 5):
        hands, grasp = waved(step)
        simulator.step(grasp, hands, DT)

    again = simulator.reset(seeded(3), params())

    assert np.array_equal(first.vertices, again.vertices)
    assert again.time_s == 0.0


def test_a_cloth_torn_a_metre_apart_stretches_and_comes_back(simulator):
    simulator.reset(seeded(), params())

    torn = simulator.step(GRASP - [1.0, 0.0, 0.0], HANDS, DT)
    for _ in range(60):
        back = simulator.step(GRASP, HANDS, DT)

    assert not torn.feasible
    assert np.isfinite(torn.vertices).all()
    assert strains(torn, simulator.mesh()).max() > 0.5
    assert np.abs(strains(back, simulator.mesh())).max() < 0.03


def test_all_four_corners_in_one_point_are_survived(simulator):
    point = np.tile([0.5, 0.0, 0.4], (2, 1))

    simulator.reset(seeded(), params(hands=point, grasp=point))
    state = simulator.step(point, point, DT)

    assert np.isfinite(state.vertices).all()
    assert state.feasible


def test_stepping_before_reset_says_so(simulator):
    with pytest.raises(ClothrfError, match=r"expected reset\(\) before this call"):
        simulator.step(GRASP, HANDS, DT)


@pytest.mark.parametrize("dt", [0.0, -1.0, np.nan])
def test_time_must_pass(simulator, dt):
    simulator.reset(seeded(), params())

    with pytest.raises(ShapeError, match="expected dt > 0 seconds"):
        simulator.step(GRASP, HANDS, dt)


def test_corners_that_are_not_finite_are_refused(simulator):
    simulator.reset(seeded(), params())

    with pytest.raises(ShapeError, match="NaN or infinity"):
        simulator.step(GRASP * np.nan, HANDS, DT)


@pytest.mark.parametrize(
    "changes",
    [
        {"resolution": (1, 5)},
        {"size": (0.0, 0.3)},
        {"fabric": replace(Fabric(), density=0.0)},
        {"fabric": replace(Fabric(), bending=-1.0)},
        {"fabric": replace(Fabric(), stretch_warp=np.nan)},
    ],
)
def test_impossible_cloth_is_refused_with_its_numbers(simulator, changes):
    with pytest.raises(ConfigError, match="expected"):
        simulator.reset(seeded(), params(**changes))
