"""Both engines keep the contract of a rendered camera, with and without colour."""

from __future__ import annotations

import pytest
from clothrf_raster.camera import RasterCamera
from clothrf_raster.config import RasterConfig

from clothrf_core.interfaces import RenderedCamera
from clothrf_core.testing.camera import check_rendered_camera, checks


@pytest.mark.parametrize("check", list(checks()), ids=lambda check: check.__name__)
@pytest.mark.parametrize("engine", ["numba", "numpy"])
def test_each_promise_is_kept(engine, check):
    with RasterCamera(RasterConfig(engine=engine)) as camera:
        check(camera)


def test_the_promises_hold_without_colour():
    check_rendered_camera(lambda: RasterCamera(RasterConfig(colour=False)))


def test_it_is_a_rendered_camera():
    assert isinstance(RasterCamera(RasterConfig()), RenderedCamera)
