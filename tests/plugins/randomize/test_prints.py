"""Textures: every kind is drawn, seeds repeat, strength 0 is plain, hues stay apart."""

from __future__ import annotations

import colorsys
import dataclasses

import numpy as np
import pytest
from clothrf_randomize.config import StandardConfig, TextureSpread
from clothrf_randomize.prints import KINDS, SHADES, draw_prints, texels
from clothrf_randomize.standard import Standard

from clothrf_core.scene import Label, Scene
from clothrf_core.testing.camera import example_camera, example_scene
from clothrf_core.testing.randomizer import same

TEAL = (0.10, 0.45, 0.50)
CAMERA = example_camera()


def prints(seed, **options):
    return draw_prints(np.random.default_rng(seed), TEAL, CAMERA, TextureSpread(**options))


def hues(colours):
    return np.array([360.0 * colorsys.rgb_to_hsv(*c)[0] for c in colours])


def apart(a, b):
    return np.abs((a - b + 180.0) % 360.0 - 180.0)


def test_equal_seeds_print_the_same_and_others_something_else():
    assert same(prints(3), prints(3))
    assert not same(prints(3), prints(4))


def test_strength_zero_prints_nothing():
    assert same(prints(0, strength=0.0), type(prints(0))())


@pytest.mark.parametrize("kind", KINDS)
def test_each_kind_has_as_many_shades_as_its_name_says(kind):
    found = np.unique(texels(np.random.default_rng(0), kind))
    expected = {"plain": [0], "chequer": [0, SHADES - 1], "stripes": [0, SHADES - 1]}
    assert found.tolist() == expected.get(kind, list(range(SHADES)))


@pytest.mark.parametrize("strength", [0.5, 1.0, 2.0])
def test_the_cloth_keeps_its_hue_and_the_rest_keeps_off_it(strength):
    hue = hues([TEAL])[0]
    for seed in range(30):
        found = prints(seed, strength=strength)
        if found.cloth is not None:
            assert apart(hues(found.cloth.colours), hue).max() <= strength * 5.0 + 1e-9
        for pattern in (found.table, found.backdrop.pattern):
            # A grey has no hue to speak of.
            vivid = np.ptp(pattern.colours, axis=1) / pattern.colours.max(axis=1) > 0.15
            assert (apart(hues(pattern.colours[vivid]), hue) > 40.0).all()


def test_the_backdrop_fills_what_is_left_of_the_picture_and_gives_no_depth():
    raster = pytest.importorskip("clothrf_raster.camera")
    config = pytest.importorskip("clothrf_raster.config")
    camera = dataclasses.replace(CAMERA, distortion=np.array([0.05, 0.0, 0.0, 0.0, 0.0]))
    scene = Scene(meshes=(draw_prints(np.random.default_rng(1), TEAL, camera,
                                      TextureSpread()).backdrop,))  # fmt: skip

    seen = raster.RasterCamera(config.RasterConfig()).render(scene, camera)

    assert (seen.labels == Label.BACKDROP).all()
    assert np.isnan(seen.frame.depth).all()


def test_a_cloth_found_by_its_hue_stays_found(nominal):
    raster = pytest.importorskip("clothrf_raster.camera")
    config = pytest.importorskip("clothrf_raster.config")
    cv2 = pytest.importorskip("cv2")
    sheet = example_scene(CAMERA).meshes[0]
    renderer = raster.RasterCamera(config.RasterConfig())
    seen_by = dataclasses.replace(nominal, camera=CAMERA)
    made = Standard(StandardConfig.model_validate({"only": ["texture"]}))
    places = sheet.vertices[:, :2] - sheet.vertices[:, :2].min(axis=0)
    for seed in range(10):
        drawn = made.draw(np.random.default_rng(seed), seen_by)
        cloth = dataclasses.replace(sheet, colour=drawn.cloth_colour)
        if drawn.cloth_pattern is not None:
            cloth = cloth.printed(drawn.cloth_pattern, places / places.max(axis=0))
        seen = renderer.render(Scene(meshes=(cloth, drawn.backdrop)), CAMERA)

        hsv = cv2.cvtColor(seen.frame.rgb, code=cv2.COLOR_RGB2HSV).astype(float)
        found = (apart(2.0 * hsv[..., 0], 187.0) < 20.0) & (hsv[..., 1] > 0.15 * 255)
        truth = seen.labels == Label.CLOTH

        assert (found & truth).sum() > 0.97 * (found | truth).sum()
