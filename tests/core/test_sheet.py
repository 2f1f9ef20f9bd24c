import numpy as np
import pytest

from clothrf_core.sheet import grid_mesh, hung, reachable

FLAT = np.array([[0, 0, 0], [0.3, 0, 0], [0, 0.35, 0], [0.3, 0.35, 0]], float)


@pytest.mark.parametrize("resolution", [(7, 9), (9, 7), (2, 2)])
def test_corners_are_hand_0_hand_1_grasp_0_grasp_1_and_every_edge_is_there_once(resolution):
    mesh, (nu, nv) = grid_mesh((0.3, 0.35), resolution), resolution

    assert np.allclose(mesh.rest[mesh.corners], [[0, 0], [0.3, 0], [0, 0.35], [0.3, 0.35]])
    assert len({tuple(sorted(e)) for e in mesh.edges.tolist()}) == len(mesh.edges)
    assert len(mesh.edges) == (nu - 1) * nv + nu * (nv - 1)


def test_a_flat_sheet_reaches_its_own_corners_and_no_farther():
    assert reachable(FLAT, (0.3, 0.35))
    assert not reachable(FLAT * 1.01, (0.3, 0.35))


def test_the_diagonal_alone_can_be_too_long():
    sheared = FLAT + np.array([[0, 0, 0], [0, 0, 0], [0.1, -0.02, 0], [0.1, -0.02, 0]])

    sides = [(0, 1), (2, 3), (0, 2), (1, 3)]
    assert all(np.linalg.norm(sheared[i] - sheared[j]) <= 0.35 for i, j in sides)
    assert not reachable(sheared, (0.3, 0.35))


def test_threads_start_at_their_own_length_and_hang_between_the_corners():
    rest = grid_mesh((0.3, 0.35), (4, 40)).rest
    corners = np.array([[0, 0, 1], [0.3, 0, 1], [0, 0.2, 1], [0.3, 0.2, 1]], float)

    shape = hung(rest, corners).reshape(40, 4, 3)

    length = np.linalg.norm(np.diff(shape[:, 1], axis=0), axis=1).sum()
    assert length == pytest.approx(0.35, rel=2e-3)
    assert np.allclose(shape[[0, 0, -1, -1], [0, -1, 0, -1]], corners)
    assert shape[:, 1, 2].min() < 0.9
