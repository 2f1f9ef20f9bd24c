from __future__ import annotations

import numpy as np
import pytest
from clothrf_how.rivals import distance, fits_better, thickness

H, W = 60, 80
ORIGIN = np.zeros(3, np.float32)


@pytest.fixture
def rays():
    """A millimetre a pixel at one metre, looking along z."""
    y, x = np.mgrid[:H, :W] * 1e-3
    return np.stack([x, y, np.ones_like(x)]).astype(np.float32)


def _piece(rows, columns, depth=1.0):
    mask = np.zeros((H, W), bool)
    mask[rows, columns] = True
    return mask, np.where(mask, depth, 0.0).astype(np.float32)


SHEET = _piece(slice(10, 50), slice(20, 60))
BAR = _piece(slice(0, 60), slice(0, 15))


def test_a_sheet_is_thicker_than_bars_of_more_pixels():
    bars = _piece(slice(None), np.arange(W) % 10 > 3)

    assert bars[0].sum() > SHEET[0].sum()
    assert thickness(SHEET[0]) > thickness(bars[0])


def test_the_distance_is_that_from_the_line_between_the_grippers(rays):
    grasp = np.array([[0.02, 0.03, 1.0], [0.06, 0.03, 1.0]])
    far = (SHEET[0], np.where(SHEET[0], 1.5, 0.0).astype(np.float32))

    # Rows 10 to 49 are up to 20 mm from row 30, in the middle 10.
    assert distance(SHEET, rays, ORIGIN, grasp) == pytest.approx(0.010, abs=1e-3)
    assert distance(far, rays, ORIGIN, grasp) == pytest.approx(0.5, abs=0.01)


def test_what_the_grippers_are_near_to_is_the_cloth(rays):
    far = (SHEET[0], np.where(SHEET[0], 1.5, 0.0).astype(np.float32))
    at_bar = np.array([[0.005, 0.0, 1.0], [0.005, 0.05, 1.0]])

    assert fits_better(BAR, far, rays, ORIGIN, at_bar)
    assert not fits_better(far, BAR, rays, ORIGIN, at_bar)


@pytest.mark.parametrize("grasp", [None, np.full((2, 3), np.nan), np.full((2, 3), 9.0)])
def test_without_grippers_nearby_the_thicker_is_the_cloth(rays, grasp):
    assert fits_better(SHEET, BAR, rays, ORIGIN, grasp)
    assert not fits_better(BAR, SHEET, rays, ORIGIN, grasp)


def test_nothing_is_no_cloth(rays):
    nothing = (np.zeros((H, W), bool), np.zeros((H, W), np.float32))

    assert fits_better(BAR, nothing, rays, ORIGIN, np.full((2, 3), 9.0))
