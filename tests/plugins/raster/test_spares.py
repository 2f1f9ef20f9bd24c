"""Arrays are used again only when nobody can see them."""

from __future__ import annotations

import numpy as np
from clothrf_raster.camera import RasterCamera
from clothrf_raster.config import RasterConfig
from clothrf_raster.spares import MOST, Spares

from clothrf_core.testing.camera import example_camera, example_scene


def address(array):
    return array.__array_interface__["data"][0]


def test_an_array_that_was_let_go_is_given_again():
    spares = Spares((4, 5), np.float32)
    first = address(spares.take())

    assert address(spares.take()) == first


def test_an_array_that_is_held_is_never_given_again():
    spares = Spares((4, 5), np.float32)
    held = [spares.take() for _ in range(MOST + 3)]

    assert len({address(array) for array in held}) == MOST + 3
    assert address(spares.take()) not in {address(array) for array in held}


def test_a_slice_of_a_read_only_view_keeps_its_array():
    spares = Spares((4, 5), np.float32)
    whole = spares.take()
    view = whole.view()
    view.flags.writeable = False
    part = view[1:3, ::2].T
    taken = address(whole)
    del whole, view

    assert address(spares.take()) != taken
    assert part.shape == (3, 2)


def test_pictures_that_are_kept_stay_and_dropped_ones_make_room():
    model = example_camera()
    scene = example_scene(model)
    renderer = RasterCamera(RasterConfig())
    depth = renderer.render(scene, model).frame.depth[10:20]
    before = depth.copy()
    places = set()
    for _ in range(10):
        places.add(address(renderer.render(scene, model).frame.depth))

    assert np.array_equal(depth, before, equal_nan=True)
    assert len(places) == 1
