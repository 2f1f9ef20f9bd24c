from __future__ import annotations

import numpy as np
import pytest
from clothrf_sapien.config import ClothOptions
from clothrf_sapien.fabrics import FABRICS
from clothrf_sapien.simulator import ClothBatch, ClothSimulator
from hypothesis import HealthCheck, given, settings
from hypothesis import strategies as st

from clothrf_core.errors import ConfigError
from clothrf_core.params import Fabric
from clothrf_core.sheet import hung, reachable

from .sheets import GRASP, HANDS, params

DT = 1 / 30


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


@pytest.mark.parametrize("resolution", [(7, 9), (9, 7), (2, 2)])
def test_the_corners_are_hand_0_hand_1_grasp_0_grasp_1(resolution) -> None:
    simulator = ClothSimulator(ClothOptions())

    state = simulator.reset(seeded(), params(resolution=resolution))

    mesh = simulator.mesh()
    assert np.array_equal(state.vertices[mesh.corners], np.concatenate([HANDS, GRASP]))
    assert np.allclose(mesh.rest[mesh.corners], [[0, 0], [0.3, 0], [0, 0.35], [0.3, 0.35]])


@pytest.mark.parametrize("resolution", [(7, 9), (9, 7)])
def test_reported_edges_join_neighbours_of_the_grid_and_each_once(resolution) -> None:
    simulator = ClothSimulator(ClothOptions())
    simulator.reset(seeded(), params(resolution=resolution))
    mesh, (nu, nv) = simulator.mesh(), resolution

    way = np.abs(mesh.rest[mesh.edges[:, 0]] - mesh.rest[mesh.edges[:, 1]])
    cell = np.array([0.30 / (nu - 1), 0.35 / (nv - 1)])
    assert len({tuple(sorted(e)) for e in mesh.edges.tolist()}) == len(mesh.edges)
    assert len(mesh.edges) == (nu - 1) * nv + nu * (nv - 1)
    assert np.all(np.isclose(way, cell * [1, 0]).all(1) | np.isclose(way, cell * [0, 1]).all(1))


def test_many_cloths_in_one_call_move_like_each_alone_bit_for_bit() -> None:
    options = ClothOptions()
    cloths = [params(), params(fabric=FABRICS["11oz-black-denim"]), params(size=(0.31, 0.36))]
    batch = ClothBatch(options)
    together = batch.reset([seeded(i) for i in range(3)], cloths)
    alone = [ClothSimulator(options) for _ in cloths]
    apart = [s.reset(seeded(i), p) for i, (s, p) in enumerate(zip(alone, cloths, strict=True))]

    for step in range(1, 8):
        hands, grasp = waved(step)
        apart = [s.step(grasp, hands, DT) for s in alone]
        threads = 1 + step % 2
        together = batch.step_many(
            np.stack([grasp] * 3), np.stack([hands] * 3), DT, threads=threads
        )

    for one, other in zip(together, apart, strict=True):
        assert np.array_equal(one.vertices, other.vertices)
        assert np.array_equal(one.velocities, other.velocities)
        assert (one.time_s, one.feasible) == (other.time_s, other.feasible)


def test_settling_for_different_times_does_not_disturb_the_neighbours() -> None:
    cloths = [params(settle_s=0.3), params(settle_s=0.0), params(settle_s=0.1)]

    together = ClothBatch(ClothOptions()).reset([seeded(i) for i in range(3)], cloths)

    for i, p in enumerate(cloths):
        alone = ClothSimulator(ClothOptions()).reset(seeded(i), p)
        assert np.array_equal(together[i].vertices, alone.vertices)


def test_another_seed_gives_another_cloth_but_only_just() -> None:
    one = ClothSimulator(ClothOptions()).reset(seeded(1), params())
    other = ClothSimulator(ClothOptions()).reset(seeded(2), params())

    difference = np.abs(one.vertices - other.vertices).max()
    assert 0.0 < difference < 5e-3


def test_slack_hangs_below_the_corners() -> None:
    p = params(resolution=(11, 12))
    state = ClothSimulator(ClothOptions()).reset(seeded(), p)

    lowest = state.vertices[:, 2].min()
    assert lowest < min(HANDS[:, 2].min(), GRASP[:, 2].min()) - 0.05


def test_feasible_corners_keep_strain_small_while_they_move() -> None:
    simulator = ClothSimulator(ClothOptions())
    simulator.reset(seeded(), params(resolution=(11, 12), settle_s=0.5))
    found = []
    for step in range(1, 60):
        hands, grasp = waved(step)
        state = simulator.step(grasp, hands, DT)
        assert state.feasible
        found.append(strains(state, simulator.mesh()))

    assert np.quantile(np.abs(found), 0.999) < 0.03


@pytest.mark.parametrize(
    ("move", "feasible"),
    [
        ([0.0, 0.0, 0.0], True),
        ([-0.0499, 0.0, -0.02], True),
        ([-0.06, 0.0, -0.02], False),
        ([0.0, 0.2, 0.0], False),
    ],
)
def test_the_flag_says_whether_the_cloth_reaches(move, feasible) -> None:
    # The sides are 0.35 m: 0.30 apart at the start.
    simulator = ClothSimulator(ClothOptions())
    simulator.reset(seeded(), params())

    state = simulator.step(GRASP + move, HANDS, DT)

    assert state.feasible is feasible


def test_the_diagonal_alone_can_be_too_long() -> None:
    flat = np.array([[0, 0, 0], [0.3, 0, 0], [0, 0.35, 0], [0.3, 0.35, 0]], float)
    sheared = flat + np.array([[0, 0, 0], [0, 0, 0], [0.1, -0.02, 0], [0.1, -0.02, 0]])

    sides = [(0, 1), (2, 3), (0, 2), (1, 3)]
    assert all(np.linalg.norm(sheared[i] - sheared[j]) <= 0.35 for i, j in sides)
    assert reachable(flat, (0.3, 0.35))
    assert not reachable(sheared, (0.3, 0.35))


@settings(max_examples=12, deadline=None, suppress_health_check=list(HealthCheck))
@given(
    seed=st.integers(0, 2**32 - 1),
    reach=st.sampled_from([0.05, 0.3, 2.0]),
    fabric=st.sampled_from(sorted(FABRICS)),
    dt=st.sampled_from([1e-4, 1 / 240, 1 / 30, 0.2]),
)
def test_whatever_the_corners_do_the_numbers_stay_finite(seed, reach, fabric, dt) -> None:
    rng = np.random.default_rng(seed)
    simulator = ClothSimulator(ClothOptions())
    start = rng.uniform(-reach, reach, size=(4, 3))
    p = params(hands=start[:2], grasp=start[2:], fabric=FABRICS[fabric], settle_s=0.1)
    simulator.reset(seeded(seed), p)

    for _ in range(6):
        corners = rng.uniform(-reach, reach, size=(4, 3))
        state = simulator.step(corners[2:], corners[:2], dt)
        assert np.isfinite(state.vertices).all()
        assert np.isfinite(state.velocities).all()
        assert np.array_equal(state.hands, corners[:2])


@pytest.mark.parametrize("name", sorted(FABRICS))
def test_every_fabric_holds_its_own_weight_within_three_percent(name) -> None:
    simulator = ClothSimulator(ClothOptions())
    p = params(resolution=(11, 12), fabric=FABRICS[name], settle_s=1.0)

    state = simulator.reset(seeded(), p)

    assert np.quantile(np.abs(strains(state, simulator.mesh())), 0.999) < 0.03


def test_the_default_fabric_is_the_paper_s() -> None:
    assert FABRICS["camel-ponte-roma"] == Fabric()
    assert len(FABRICS) == 10


def test_threads_start_at_their_own_length_and_hang_between_the_corners() -> None:
    rest = np.stack(np.meshgrid(np.linspace(0, 0.3, 4), np.linspace(0, 0.35, 40)), -1).reshape(
        -1, 2
    )
    corners = np.array([[0, 0, 1], [0.3, 0, 1], [0, 0.2, 1], [0.3, 0.2, 1]], float)

    shape = hung(rest, corners).reshape(40, 4, 3)

    length = np.linalg.norm(np.diff(shape[:, 1], axis=0), axis=1).sum()
    assert length == pytest.approx(0.35, rel=2e-3)
    assert np.allclose(shape[[0, 0, -1, -1], [0, -1, 0, -1]], corners)


def test_cloths_of_different_resolution_are_no_batch() -> None:
    with pytest.raises(ConfigError, match="one resolution"):
        ClothBatch(ClothOptions()).reset(
            [seeded(), seeded()], [params(), params(resolution=(5, 5))]
        )
