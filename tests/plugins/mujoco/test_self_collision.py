"""Layers of a twisted cloth stay apart where that is asked for."""

from __future__ import annotations

import numpy as np
import pytest

from clothrf_core.registry import Registry
from clothrf_core.sheet import grid_mesh
from clothrf_core.testing.simulator import DT, params

from .crossings import crossings

pytest.importorskip("mujoco", reason="needs the extra 'mujoco'")

HANDS = np.array([[0.65, -0.14, 0.30], [0.65, 0.14, 0.30]])
GRASP = np.array([[0.38, -0.08, 0.30], [0.38, 0.08, 0.30]])


def turned(angle: float) -> np.ndarray:
    """The grasp turned about the axis between the two sides."""
    middle, half = GRASP.mean(axis=0), 0.5 * (GRASP[1] - GRASP[0])[1]
    side = half * np.array([0.0, np.cos(angle), np.sin(angle)])
    return np.stack([middle - side, middle + side])


def twist(*, collide: bool):
    """Half a turn, slowly; crossings at its end."""
    simulator = Registry.installed().build("simulator", "mujoco")
    simulator.reset(
        np.random.default_rng(0), params(hands=HANDS, grasp=GRASP, self_collision=collide)
    )
    for step in range(1, 61):
        state = simulator.step(turned(np.pi * step / 60), HANDS, DT)
    return state, crossings(state.vertices, simulator.mesh())


def test_the_counter_finds_a_sheet_folded_through_itself():
    mesh = grid_mesh((0.3, 0.35), (4, 5))
    flat = np.concatenate([mesh.rest, np.zeros((20, 1))], axis=1)
    through = flat + [0.0, 0.0, 0.02] * (mesh.rest[:, 1:] > 0.3)
    through[mesh.corners[3]] = [0.05, 0.05, -0.03]

    assert crossings(flat, mesh) == 0
    assert crossings(through, mesh) > 0


def test_half_a_turn_crosses_layers_unless_they_are_kept_apart():
    loose, without = twist(collide=False)
    kept, with_contact = twist(collide=True)

    assert without > 0
    assert with_contact == 0
    assert np.isfinite(kept.vertices).all()
    assert np.array_equal(kept.grasp, loose.grasp)


def test_where_contacts_would_stop_a_corner_it_arrives_all_the_same(tmp_path, monkeypatch, capfd):
    monkeypatch.chdir(tmp_path)
    rng = np.random.default_rng(1)
    simulator = Registry.installed().build("simulator", "mujoco")
    corners = rng.uniform(-0.05, 0.05, size=(4, 3))
    crumpled = {"hands": corners[:2], "grasp": corners[2:], "resolution": (5, 6)}
    simulator.reset(rng, params(settle_s=0.1, self_collision=True, **crumpled))
    stopped = 0
    for _ in range(4):
        corners = rng.uniform(-0.05, 0.05, size=(4, 3))
        state = simulator.step(corners[2:], corners[:2], DT)
        stopped = max(stopped, simulator._stepper._pause)
        assert np.array_equal(state.vertices[simulator.mesh().corners], corners)
        assert np.isfinite(state.vertices).all()
        assert np.isfinite(state.velocities).all()

    assert stopped > 0, "contacts never stopped a corner"
    assert capfd.readouterr().err == ""
    assert list(tmp_path.iterdir()) == []
