from __future__ import annotations

import numpy as np
import pytest
from clothrf_sapien.bench_motions import motion
from clothrf_sapien.cloth import Cloths, spread
from clothrf_sapien.config import ClothOptions
from clothrf_sapien.simulator import ClothSimulator
from clothrf_sapien.truths import (
    cantilever_error,
    catenary,
    catenary_error,
    elastica_angle,
    hanging_elongation,
)

from .sheets import FABRIC, params, total_energy, woven


def test_a_sheet_hung_from_two_edges_is_a_catenary() -> None:
    assert catenary_error(resolution=(8, 24)) < 0.002


def test_a_strip_hangs_under_its_weight_like_the_elastica() -> None:
    assert cantilever_error(resolution=(5, 24)) < 0.02


def test_a_stiff_strip_hangs_like_the_elastica_too() -> None:
    assert cantilever_error(resolution=(5, 24), bending=5e-3) < 0.02


@pytest.mark.parametrize("stretch", [50.0, 1000.0])
def test_a_hanging_sheet_grows_as_its_weight_says(stretch) -> None:
    assert hanging_elongation(stretch, resolution=(11, 12)) == pytest.approx(1.0, abs=0.02)


def test_the_catenary_s_sag_agrees_with_the_number_of_the_trials() -> None:
    # 109.5 mm were measured against; the span is the one that gives it.
    a, sag = catenary(0.35, 0.25)

    assert 2 * a * np.sinh(0.125 / a) == pytest.approx(0.35)
    assert a * (np.cosh(0.125 / a) - 1) == pytest.approx(sag)


def test_the_elastica_agrees_with_the_linear_beam_for_small_deflection() -> None:
    bending, weight, length = 1.0, 0.01, 1.0

    # Tip deflection of a clamped beam under its weight: w l^4 / (8 B).
    assert elastica_angle(bending, weight, length) == pytest.approx(0.01 / 8, rel=1e-3)


def test_the_elastica_agrees_with_peirce_at_his_angle() -> None:
    # Peirce: at 41.5 degrees the overhang is twice the bending length.
    assert np.degrees(elastica_angle(1.0, 8.0, 1.0)) == pytest.approx(41.5, abs=0.1)


def test_energy_does_not_grow_while_the_corners_are_still() -> None:
    w = woven((9, 10), fabric=FABRIC)
    rest = w.mesh.rest
    rng = np.random.default_rng(0)
    start = np.concatenate([0.9 * rest, rng.normal(scale=0.01, size=(len(rest), 1))], axis=1)
    corners = w.mesh.corners.astype(np.int64)
    cloths = Cloths([w], start[None], corners)

    energies = []
    for _ in range(150):
        energies.append(total_energy(w, cloths))
        cloths.advance(start[None, corners], 1 / 30, substeps=1, iterations=50, tolerance=1e-4)

    assert np.diff(energies).max() < 1e-6 * (energies[0] - energies[-1])
    assert energies[0] - energies[-1] > 1e-3


@pytest.mark.parametrize("task", ["straight", "bent", "twisted"])
def test_the_cloth_comes_to_rest_when_nothing_moves(task) -> None:
    hands, grasp = motion(task, 1, seed=2)
    simulator = ClothSimulator(ClothOptions())
    simulator.reset(
        np.random.default_rng(1), params(resolution=(21, 24), hands=hands[0], grasp=grasp[0])
    )

    for _ in range(240):
        state = simulator.step(grasp[0], hands[0], 1 / 30)

    # A Newton tolerance of 1 mm, whatever the travel, left 90 mm/s here.
    assert np.abs(state.velocities).max() < 2e-3


def test_what_one_corner_does_unforeseen_the_sheet_is_guessed_to_share_bilinearly() -> None:
    w = woven((5, 7), fabric=FABRIC)

    share = spread(w, w.mesh.corners.astype(np.int64))

    np.testing.assert_allclose(share.sum(axis=0), 1.0, atol=1e-12)
    np.testing.assert_allclose(share[:, w.mesh.corners], np.eye(4), atol=1e-12)
    np.testing.assert_allclose(share.T @ w.mesh.rest[w.mesh.corners], w.mesh.rest, atol=1e-12)
    assert not spread(w, np.array([0, 1, 2])).any()
