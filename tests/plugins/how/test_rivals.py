from __future__ import annotations

import numpy as np
import pytest
from clothrf_how.rivals import between, fits_better, thickness

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


def test_what_lies_on_the_line_between_the_grippers_is_counted(rays):
    grasp = np.array([[0.03, 0.03, 1.0], [0.05, 0.03, 1.0]])

    assert between(SHEET, rays, ORIGIN, grasp) == SHEET[0].sum()
    assert between((SHEET[0], SHEET[1] * 1.2), rays, ORIGIN, grasp) == 0


def test_the_grippers_say_which_is_the_cloth(rays):
    far = (SHEET[0], SHEET[1] * 1.5)
    at_bar = np.array([[0.005, 0.0, 1.0], [0.005, 0.05, 1.0]])

    assert fits_better(BAR, far, rays, ORIGIN, at_bar)
    assert not fits_better(far, BAR, rays, ORIGIN, at_bar)


@pytest.mark.parametrize("grasp", [None, np.full((2, 3), np.nan), np.full((2, 3), 9.0)])
def test_without_grippers_nearby_the_thicker_is_the_cloth(rays, grasp):
    assert fits_better(SHEET, BAR, rays, ORIGIN, grasp)
    assert not fits_better(BAR, SHEET, rays, ORIGIN, grasp)
