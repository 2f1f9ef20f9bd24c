from __future__ import annotations

import numpy as np
import pytest
from clothrf_sapien.bench_motions import motion
from clothrf_sapien.config import ClothOptions
from clothrf_sapien.contact import find, press, stiffen
from clothrf_sapien.simulator import ClothSimulator

from .sheets import contacts, params

TRIANGLES = np.array([[0, 1, 2]], np.int64)


def triangle_and_point(height: float) -> np.ndarray:
    """(3, 40) a triangle of vertices 0, 1, 2 and vertex 39 above it; the rest far away."""
    x = np.full((40, 3), 9.0) + np.arange(40)[:, None]
    x[:3] = [[0, 0, 0], [0.02, 0, 0], [0, 0.02, 0]]
    x[39] = [0.006, 0.004, height]
    return np.ascontiguousarray(x.T)


@pytest.mark.parametrize("height", [0.003, -0.003])
def test_a_vertex_near_a_triangle_is_pushed_to_the_side_it_is_on(height) -> None:
    x = triangle_and_point(height)
    c = contacts(10, stiffness=100.0, thickness=0.005)
    g = np.zeros((3, 40))

    find(x, x, TRIANGLES, 4, c)
    value = press(x, c, g)

    assert c.count[0] == 1
    assert value == pytest.approx(0.5 * 100.0 * 0.002**2)
    assert np.allclose(-g[:, 39], [0, 0, np.sign(height) * 100.0 * 0.002])
    assert np.allclose(g.sum(axis=1), 0.0)
    assert np.allclose(-g[2, :3], -np.sign(height) * 0.2 * np.array([0.5, 0.3, 0.2]))


def test_the_push_is_the_gradient_of_its_energy() -> None:
    x = triangle_and_point(0.003)
    c = contacts(10, stiffness=100.0, thickness=0.005)
    find(x, x, TRIANGLES, 4, c)
    g, nothing = np.zeros((3, 40)), np.zeros((3, 40))
    press(x, c, g)

    for index in [(2, 39), (2, 0), (2, 1), (0, 39)]:
        ahead, behind = x.copy(), x.copy()
        ahead[index] += 1e-6
        behind[index] -= 1e-6
        slope = (press(ahead, c, nothing) - press(behind, c, nothing)) / 2e-6
        assert g[index] == pytest.approx(slope, abs=1e-7)


def test_the_diagonal_bound_lies_above_the_pair_s_hessian() -> None:
    x = triangle_and_point(0.003)
    c = contacts(10, stiffness=100.0, thickness=0.005)
    find(x, x, TRIANGLES, 4, c)
    press(x, c, np.zeros((3, 40)))
    own = np.zeros((6, 40))
    stiffen(c, own)

    weights = c.weights[0]
    exact = 100.0 * np.outer(weights, weights)
    bound = np.diag(own[5, c.pairs[0]])
    assert np.linalg.eigvalsh(bound - exact).min() > -1e-9


def test_vertices_beyond_the_thickness_feel_nothing() -> None:
    x = triangle_and_point(0.0055)
    c = contacts(10, stiffness=100.0, thickness=0.005)
    find(x, x, TRIANGLES, 4, c)
    g = np.zeros((3, 40))

    assert press(x, c, g) == 0.0
    assert not g.any()


def test_neighbours_in_the_weave_do_not_collide() -> None:
    x = triangle_and_point(0.003)
    x[:, [5, 39]] = x[:, [39, 5]]
    c = contacts(10, stiffness=100.0, thickness=0.005)

    find(x, x, TRIANGLES, 4, c)

    assert c.count[0] == 0


def test_a_full_list_of_pairs_is_no_error() -> None:
    x = triangle_and_point(0.003)
    c = contacts(0, stiffness=100.0, thickness=0.005)

    find(x, x, TRIANGLES, 4, c)

    assert c.count[0] == 0


def crossings(state, mesh) -> int:
    """Edges that pass through a triangle."""
    x = state.vertices
    count = 0
    a, b, c = (x[mesh.triangles[:, k]] for k in range(3))
    u, v = b - a, c - a
    for i, j in mesh.edges:
        d = x[j] - x[i]
        h = np.cross(d, v)
        with np.errstate(divide="ignore", invalid="ignore"):
            f = 1.0 / np.sum(u * h, axis=1)
            s = x[i] - a
            p = f * np.sum(s * h, axis=1)
            q = np.cross(s, u)
            r, t = f * (q @ d), f * np.sum(v * q, axis=1)
            hit = (p >= 0) & (r >= 0) & (p + r <= 1) & (t > 0) & (t < 1)
        count += int(np.sum(hit & ~np.any(np.isin(mesh.triangles, (i, j)), axis=1)))
    return count


def test_a_twisted_cloth_unfolds_without_passing_through_itself() -> None:
    hands, grasp = motion("twisted", 1, seed=1)
    found = {}
    for layers in (False, True):
        simulator = ClothSimulator(ClothOptions())
        wanted = params(hands=hands[0], grasp=grasp[0], resolution=(21, 24), self_collision=layers)
        state = simulator.reset(np.random.default_rng(1), wanted)
        found[layers] = crossings(state, simulator.mesh())

    assert found[False] > 5
    assert found[True] == 0
