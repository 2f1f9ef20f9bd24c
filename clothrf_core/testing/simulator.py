"""What every `Simulator` promises: same seed same bits, bounded strain, finite for any motion."""

from __future__ import annotations

from collections.abc import Callable

import numpy as np

from clothrf_core.interfaces import Simulator
from clothrf_core.params import SimulationParams
from clothrf_core.types import ClothMesh, ClothState, Float

DT = 1.0 / 30.0
HANDS = np.array([[0.65, -0.14, 0.30], [0.65, 0.14, 0.30]])
GRASP = np.array([[0.35, -0.14, 0.32], [0.35, 0.14, 0.32]])


def check_simulator(make: Callable[[], Simulator], *, strain: float = 0.05) -> None:
    """Run the whole suite.

    Args:
        make: builds a fresh simulator.
        strain: largest edge strain allowed (99.9th percentile) for feasible corners.

    Raises:
        AssertionError: saying which promise is broken.
    """
    check_mesh(make())
    check_corners_are_held(make())
    check_same_seed_same_bits(make(), make())
    check_strain(make(), strain)
    check_finite_when_infeasible(make())
    check_state_is_read_only(make())


def params(**changes: object) -> SimulationParams:
    """A small cloth held flat with a little slack."""
    values: dict[str, object] = {
        "hands": HANDS,
        "grasp": GRASP,
        "resolution": (11, 12),
        "settle_s": 0.2,
        **changes,
    }
    return SimulationParams(**values)  # type: ignore[arg-type]


def check_mesh(simulator: Simulator) -> None:
    """The mesh fits the state, the rest shape has the asked size, the corners are where it says."""
    wanted = params()
    state = simulator.reset(np.random.default_rng(0), wanted)
    mesh = simulator.mesh()
    count = len(state.vertices)
    assert count == 11 * 12, f"expected 11 x 12 vertices, got {count}"
    assert len(mesh.rest) == count, f"{len(mesh.rest)} rest positions for {count} vertices"
    for name, index in (("triangles", mesh.triangles), ("edges", mesh.edges)):
        assert index.min() >= 0, f"{name} hold negative indices"
        assert index.max() < count, f"{name} point at vertex {index.max()} of {count}"
    extent = mesh.rest.max(axis=0) - mesh.rest.min(axis=0)
    assert np.allclose(extent, wanted.size), f"rest shape is {extent}, expected {wanted.size}"
    used = np.unique(mesh.triangles)
    assert len(used) == count, f"{count - len(used)} vertices belong to no triangle"
    area = _areas(mesh)
    assert np.isclose(area.sum(), wanted.size[0] * wanted.size[1]), "triangles do not tile it"
    u, v = mesh.rest[mesh.corners].T
    assert np.allclose(v[:2], v.min()), "hands are not at the v = 0 edge"
    assert np.allclose(v[2:], v.max()), "grasp is not at the v = length edge"
    assert u[0] == u[2] and u[1] == u[3], "grasp[i] does not face hands[i]"  # noqa: PT018


def check_corners_are_held(simulator: Simulator) -> None:
    """After a step the four corners are exactly where they were told to be."""
    simulator.reset(np.random.default_rng(0), params())
    hands, grasp = HANDS + [0.002, 0.001, 0.001], GRASP + [0.001, -0.002, 0.003]
    state = simulator.step(grasp, hands, DT)
    corner = state.vertices[simulator.mesh().corners]
    wanted = np.concatenate([hands, grasp])
    assert np.allclose(corner, wanted, atol=1e-9), f"corners off by {np.abs(corner - wanted).max()}"
    assert np.array_equal(state.hands, hands), "state.hands is not what was asked for"
    assert np.array_equal(state.grasp, grasp), "state.grasp is not what was asked for"
    assert np.isclose(state.time_s, DT), f"time is {state.time_s}, expected {DT}"


def check_same_seed_same_bits(first: Simulator, second: Simulator) -> None:
    """Equal seeds and calls give equal bits, also after an earlier roll-out."""
    first.reset(np.random.default_rng(9), params())
    first.step(GRASP + 0.004, HANDS, DT)
    for step, (a, b) in enumerate(zip(_walk(first), _walk(second), strict=True)):
        assert np.array_equal(a.vertices, b.vertices), f"vertices differ at step {step}"
        assert np.array_equal(a.velocities, b.velocities), f"velocities differ at step {step}"


def check_strain(simulator: Simulator, limit: float) -> None:
    """For feasible corners no edge stretches by more than `limit` (99.9th percentile)."""
    strains = []
    for state in _walk(simulator, steps=60):
        assert state.feasible, "corners within reach were called infeasible"
        strains.append(edge_strain(state, simulator.mesh()))
    worst = float(np.percentile(np.concatenate(strains), 99.9))
    assert worst <= limit, f"edge strain is {worst:.3f}, expected at most {limit}"


def check_finite_when_infeasible(simulator: Simulator) -> None:
    """Corners farther apart than the cloth reaches: flagged, and never NaN."""
    simulator.reset(np.random.default_rng(0), params())
    state = None
    for step in range(40):
        state = simulator.step(GRASP - [0.008 * step, 0.0, 0.0], HANDS, DT)
        assert np.isfinite(state.vertices).all(), f"NaN at step {step}"
    assert state is not None
    assert not state.feasible, "corners 0.6 m apart on a 0.35 m cloth were called feasible"
    twisted = simulator.step(GRASP[::-1].copy(), HANDS, DT)
    assert np.isfinite(twisted.vertices).all(), "NaN after the grasp was swapped in one step"


def check_state_is_read_only(simulator: Simulator) -> None:
    """A state that was handed out does not change afterwards."""
    before = simulator.reset(np.random.default_rng(0), params())
    copy = np.array(before.vertices)
    simulator.step(GRASP + 0.01, HANDS, DT)
    assert np.array_equal(before.vertices, copy), "an earlier state changed with a later step"
    assert not before.vertices.flags.writeable, "the state can be written to"


def edge_strain(state: ClothState, mesh: ClothMesh) -> Float:
    """(E,) stretch of every edge over its rest length; a compressed edge counts as zero."""
    a, b = mesh.edges.T
    rest = np.linalg.norm(mesh.rest[a] - mesh.rest[b], axis=1)
    length = np.linalg.norm(state.vertices[a] - state.vertices[b], axis=1)
    strain: Float = np.maximum(length / rest - 1.0, 0.0)
    return strain


def _walk(simulator: Simulator, steps: int = 15) -> list[ClothState]:
    states = [simulator.reset(np.random.default_rng(1), params())]
    for step in range(steps):
        sway = 0.02 * np.sin(0.1 * step) * np.array([0.0, 1.0, 0.5])
        states.append(simulator.step(GRASP + 1.2 * sway, HANDS + sway, DT))
    return states


def _areas(mesh: ClothMesh) -> Float:
    a, b, c = (mesh.rest[mesh.triangles[:, i]] for i in range(3))
    ab, ac = b - a, c - a
    areas: Float = 0.5 * np.abs(ab[:, 0] * ac[:, 1] - ab[:, 1] * ac[:, 0])
    return areas
