from __future__ import annotations

import numpy as np
import pytest
from clothrf_randomize.config import Occluders
from clothrf_randomize.occluders import draw_occluders, patch

from clothrf_core.camera_model import project
from clothrf_core.scene import Label


def fixed(**options):
    return Occluders(episode="fixed", **options)


def hidden_share(meshes, camera, simulation):
    """Share of the patch whose pixel lies inside the outline of a mesh; counts every triangle."""
    pixels, _ = project(camera, patch(simulation))
    covered = np.zeros(len(pixels), bool)
    for mesh in meshes:
        corners, _ = project(camera, np.array(mesh.vertices))
        for a, b, c in corners[mesh.triangles]:
            sides = [
                np.sign(
                    (q[0] - p[0]) * (pixels[:, 1] - p[1]) - (q[1] - p[1]) * (pixels[:, 0] - p[0])
                )
                for p, q in ((a, b), (b, c), (c, a))
            ]
            covered |= np.abs(np.sum(sides, axis=0)) == 3
    return covered.mean()


@pytest.mark.parametrize("share", [0.05, 0.15, 0.4])
@pytest.mark.parametrize("count", [1, 3])
def test_occluders_hide_the_chosen_share(nominal, share, count):
    shares = [
        hidden_share(
            draw_occluders(
                np.random.default_rng(i), nominal.camera, nominal.simulation,
                fixed(share=share, count=count),
            ),
            nominal.camera, nominal.simulation,
        )
        for i in range(12)
    ]  # fmt: skip
    # Outlines of capsules have 16 corners, plates have square ends, the patch 1,152 points.
    assert np.mean(shares) == pytest.approx(share, rel=0.1)
    assert np.abs(np.array(shares) - share).max() < 0.03 + 0.1 * share


def test_occluders_stand_between_camera_and_cloth(nominal):
    camera = nominal.camera
    _, cloth = project(camera, patch(nominal.simulation))
    for seed in range(20):
        for mesh in draw_occluders(
            np.random.default_rng(seed), camera, nominal.simulation, fixed()
        ):
            _, depth = project(camera, np.array(mesh.vertices))
            assert depth.min() > 0.0
            assert depth.mean() < cloth.max()
            assert mesh.label == Label.OCCLUDER


def test_uniform_roll_outs_have_none_to_count_occluders(nominal):
    numbers = [
        len(
            draw_occluders(
                np.random.default_rng(i), nominal.camera, nominal.simulation, Occluders()
            )
        )
        for i in range(60)
    ]
    assert set(numbers) == {0, 1, 2}


def test_no_share_no_occluders(nominal):
    for spread in (fixed(strength=0.0), fixed(share=0.0)):
        rng = np.random.default_rng(0)
        assert draw_occluders(rng, nominal.camera, nominal.simulation, spread) == ()


def test_bare_metal_occluders_read_no_depth(nominal):
    rng = np.random.default_rng(0)
    meshes = draw_occluders(rng, nominal.camera, nominal.simulation, fixed(measurable=False))
    assert [m.measurable for m in meshes] == [False, False]
