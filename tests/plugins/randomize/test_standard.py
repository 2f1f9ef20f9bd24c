from __future__ import annotations

import dataclasses
import subprocess
import sys

import clothrf_randomize
import numpy as np
import pytest
from clothrf_randomize.config import StandardConfig
from clothrf_randomize.standard import Standard

from clothrf_core.geometry import rotation_angle
from clothrf_core.registry import Registry
from clothrf_core.testing.randomizer import check_randomizer, same

PARTS = ("hands", "fabric", "size", "mesh", "camera", "light", "texture", "occluders", "sensor")


def zero(**others):
    return StandardConfig.model_validate({p: {"strength": 0.0} for p in PARTS} | others)


def draws(config, nominal, count=200):
    made = Standard(StandardConfig.model_validate(config))
    return [made.draw(np.random.default_rng(i), nominal) for i in range(count)]


@pytest.mark.parametrize("name", ["none", "standard"])
def test_every_randomizer_keeps_the_contract(name, nominal, flat):
    registry = Registry.of(clothrf_randomize)
    check_randomizer(
        lambda: registry.build("randomizer", name),
        nominal,
        flat,
        make_zero=lambda: Standard(zero()),
    )


@pytest.mark.parametrize("family", ["sr300", "d435", "kinect", "disparity", "stereo"])
def test_every_sensor_family_keeps_the_contract(family, nominal, flat):
    config = StandardConfig.model_validate({"sensor": {"family": family, "strength": 2.0}})
    check_randomizer(lambda: Standard(config), nominal, flat)


@pytest.mark.parametrize("part", PARTS)
def test_strength_zero_of_one_part_leaves_the_draws_of_the_others(part, nominal):
    full = draws({}, nominal, 1)[0]
    less = draws({part: {"strength": 0.0}}, nominal, 1)[0]
    changed = {
        f.name
        for f in dataclasses.fields(full)
        if not same(getattr(full, f.name), getattr(less, f.name))
    }
    changed |= {
        f.name
        for f in dataclasses.fields(full.simulation)
        if not same(getattr(full.simulation, f.name), getattr(less.simulation, f.name))
    }
    belongs = {
        "hands": {"hand_noise"},
        "fabric": {"simulation", "fabric"},
        "size": {"simulation", "size"},
        "mesh": {"simulation", "resolution"},
        # Occluders and backdrop stand before the camera as it really is.
        "camera": {"camera", "occluders", "backdrop"},
        # Patterns are shades of the cloth's colour, or keep off it.
        "light": {"light", "cloth_colour", "cloth_pattern", "table_pattern", "backdrop"},
        "texture": {"cloth_pattern", "table_pattern", "backdrop"},
        "occluders": {"occluders"},
        "sensor": {"sensor"},
    }
    assert changed
    assert changed <= belongs[part]


def test_only_leaves_the_named_parts_on(nominal):
    alone = draws({"only": ["camera"]}, nominal, 1)[0]
    others = {part: {"strength": 0.0} for part in PARTS if part != "camera"}
    assert same(alone, draws(others, nominal, 1)[0])
    assert not same(alone.camera, nominal.camera)
    assert same(alone.simulation, nominal.simulation)


def test_fabrics_are_log_uniform_between_half_and_double(nominal):
    drawn = draws(zero(fabric={"strength": 1.0}).model_dump(), nominal)
    ratios = np.array([d.simulation.fabric.bending / 2e-5 for d in drawn])
    assert 0.5 <= ratios.min() < 0.53
    assert 1.9 < ratios.max() <= 2.0
    assert abs(np.log(ratios).mean()) < 0.1
    others = np.array([d.simulation.fabric.density / 0.284 for d in drawn])
    assert abs(np.corrcoef(ratios, others)[0, 1]) < 0.2


def test_the_catalogue_has_ten_fabrics(nominal):
    config = zero(fabric={"strength": 1.0, "mode": "catalogue", "factor": 1.0}).model_dump()
    fabrics = {d.simulation.fabric.name: d.simulation.fabric for d in draws(config, nominal)}
    assert len(fabrics) == 10
    assert fabrics["11oz-black-denim"].density == pytest.approx(0.324)


def test_size_and_mesh_stay_in_their_ranges(nominal):
    drawn = draws({}, nominal)
    sizes = np.array([d.simulation.size for d in drawn]) / [0.30, 0.35]
    assert np.abs(sizes - 1).max() == pytest.approx(0.03, abs=0.001)
    assert {d.simulation.resolution[0] for d in drawn} == {19, 20, 21, 22, 23}
    assert {d.simulation.resolution[1] for d in drawn} == {22, 23, 24, 25, 26}


def test_the_camera_moves_as_little_as_a_calibration_errs(nominal):
    drawn = [d.camera for d in draws({}, nominal)]
    shift = np.array(
        [d.T_world_camera[:3, 3] - nominal.camera.T_world_camera[:3, 3] for d in drawn]
    )
    turn = [rotation_angle(nominal.camera.T_world_camera[:3, :3].T @ d.T_world_camera[:3, :3])
            for d in drawn]  # fmt: skip
    focal = np.array([d.K[0, 0] for d in drawn]) / 620.0
    centre = np.array([d.K[:2, 2] for d in drawn]) - [319.5, 239.5]
    assert np.abs(shift).max() == pytest.approx(0.003, rel=0.05)
    assert 0.3 < np.degrees(max(turn)) < 0.3 * np.sqrt(3)
    assert np.abs(focal - 1).max() == pytest.approx(0.002, rel=0.05)
    assert np.abs(centre).max() == pytest.approx(1.0, rel=0.05)


def test_colours_stay_colours(nominal):
    for drawn in draws({"light": {"strength": 5.0}}, nominal, 50):
        assert all(0.0 <= c <= 1.0 for c in drawn.cloth_colour)
        assert np.linalg.norm(drawn.light.direction) == pytest.approx(1.0)
        assert drawn.light.intensity >= 0.0


def test_hand_noise_is_five_millimetres(nominal):
    noise = draws({}, nominal, 1)[0].hand_noise
    assert (noise.std, noise.time_constant_s) == (0.005, 0.3)


def test_a_nominal_roll_out_has_a_perfect_sensor(nominal, flat):
    made = Standard(StandardConfig())
    assert made.corrupt(flat, nominal, np.random.default_rng(0)) is flat


def test_listing_the_plugin_imports_nothing_heavy():
    code = (
        "import sys, clothrf_randomize as p; p.clothrf_randomizers(); p.clothrf_benchmarks();"
        "print([m for m in ('numba', 'scipy', 'cv2') if m in sys.modules])"
    )
    found = subprocess.run([sys.executable, "-c", code], capture_output=True, text=True, check=True)
    assert found.stdout.strip() == "[]"
