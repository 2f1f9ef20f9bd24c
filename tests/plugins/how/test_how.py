from __future__ import annotations

import cv2
import numpy as np
import pytest
from clothrf_how.config import FeatureOptions, ForegroundOptions, HowOptions
from clothrf_how.extractor import Extractor
from clothrf_how.gabor import factors
from clothrf_how.how import How, cell_sums, how_names, rectified, relief
from clothrf_how.how_kernels import detrended
from clothrf_how.passes import Board, Grid, Passes


@pytest.mark.parametrize("layout", ["A", "B", "C", "D"])
def test_every_layout_has_768_names(layout):
    names = how_names(HowOptions(layout=layout))

    assert len(names) == 768
    assert len(set(names)) == 768


def test_names_run_over_orientation_then_column_then_row():
    names = how_names(HowOptions())

    assert names[:2] == ("how_o0_c00_r00", "how_o0_c00_r01")
    assert names[12] == "how_o0_c01_r00"
    assert names[192] == "how_o1_c00_r00"


def _scene(rng, h=90, w=130):
    picture = rng.normal(size=(h, w)).astype(np.float32)
    mask = np.zeros((h, w), bool)
    cv2.ellipse(
        img=(view := mask.astype(np.uint8)),
        center=(60, 40),
        axes=(50, 30),
        angle=20,
        startAngle=0,
        endAngle=360,
        color=1,
        thickness=-1,
    )
    mask = view.astype(bool)
    rows, columns = np.flatnonzero(mask.any(axis=1)), np.flatnonzero(mask.any(axis=0))
    box = (int(columns[0]), int(rows[0]), int(columns[-1]) + 1, int(rows[-1]) + 1)
    grid = Grid(
        rows=((np.arange(box[1], box[3]) - 4) // 10).astype(np.int32),
        columns=((np.arange(box[0], box[2]) - 25) // 10).astype(np.int32),
        shape=(6, 8),
    )
    return picture * mask, mask, box, grid


@pytest.mark.parametrize("response", ["half", "magnitude", "saturate8", "energy"])
@pytest.mark.parametrize("orientation", range(4))
def test_the_compiled_passes_equal_filter2d(response, orientation):
    rng = np.random.default_rng(3)
    picture, mask, box, grid = _scene(rng)
    picture = picture * np.float32(300.0)
    options = HowOptions()
    wave = factors(options, psi=0.0)[orientation]
    quarter = factors(options, psi=np.pi / 2)[orientation]

    options = HowOptions(response=response, every=1)
    passes = Passes.of(wave, quarter)
    board = Board.of(picture, mask, box, grid, passes.margin)
    got = passes.sums(board, board.turned(), options)

    def answer(factor):
        return cv2.filter2D(
            src=picture,
            ddepth=cv2.CV_32F,
            kernel=factor.kernel().astype(np.float32),
            borderType=cv2.BORDER_CONSTANT,
        )

    full = answer(wave)
    full = np.hypot(full, answer(quarter)) if response == "energy" else rectified(full, response)
    x0, y0, x1, y1 = box
    want = cell_sums((full * mask)[y0:y1, x0:x1], grid)
    assert want.max() > 100.0
    np.testing.assert_allclose(got, want, rtol=2e-5, atol=2e-3)


def test_cell_sums_drop_what_lies_outside_the_grid():
    values = np.ones((4, 6), np.float32)
    grid = Grid(
        rows=np.array([-1, 0, 0, 1], np.int32),
        columns=np.array([-3, 0, 0, 1, 1, 2], np.int32),
        shape=(2, 2),
    )

    np.testing.assert_array_equal(cell_sums(values, grid), [[4.0, 4.0], [2.0, 2.0]])


@pytest.mark.parametrize("degree", [1, 2])
def test_the_compiled_relief_equals_least_squares(degree):
    rng = np.random.default_rng(1)
    h, w = 40, 60
    y, x = np.mgrid[:h, :w]
    mask = rng.random((h, w)) < 0.6
    depth = (0.5 + 1e-3 * x - 2e-3 * y + 1e-5 * x * y + 0.01 * rng.random((h, w))).astype(
        np.float32
    )

    got = detrended(depth, mask, degree, (0, 0, *mask.shape[::-1]))

    u, v = x[mask] / w - 0.5, y[mask] / h - 0.5
    basis = [np.ones_like(u), u, v] + ([u * u, u * v, v * v] if degree == 2 else [])
    A = np.stack(basis, axis=1)
    c, *_ = np.linalg.lstsq(A, depth[mask].astype(float), rcond=None)
    np.testing.assert_allclose(got[mask], 1000.0 * (depth[mask] - A @ c), atol=2e-3)
    assert (got[~mask] == 0.0).all()


def test_the_histogram_sums_to_one(rig, sheet, observe):
    features = Extractor(FeatureOptions(groups=("how",)), rig).extract(observe(sheet))

    assert features.values.shape == (768,)
    assert (features.values >= 0.0).all()
    assert features.values.sum() == pytest.approx(1.0, abs=1e-5)


def test_stripes_across_x_show_in_orientation_zero(rig, sheet, observe):
    depth = np.array(sheet.depth)
    depth += np.float32(2e-3) * np.sin(2 * np.pi * np.arange(640) / 10.0).astype(np.float32)
    frame = type(sheet)(0, sheet.rgb, depth, sheet.camera)

    features = Extractor(FeatureOptions(groups=("how",)), rig).extract(observe(frame))

    per_orientation = features.values.reshape(4, -1).sum(axis=1)
    assert per_orientation.argmax() == 0
    assert per_orientation[0] > 0.5


def test_centring_takes_the_place_out_of_the_histogram(rig, sheet, observe):
    depth = np.full_like(sheet.depth, np.nan)
    moved = depth.copy()
    block = (0.5 + 0.005 * np.random.default_rng(0).random((160, 200))).astype(np.float32)
    depth[100:260, 100:300] = block
    moved[150:310, 200:400] = block
    options = HowOptions(align="center", relief="median")
    extractor = Extractor(FeatureOptions(groups=("how",), how=options))

    a, b = (
        extractor.extract(observe(type(sheet)(0, sheet.rgb, d, sheet.camera)))
        for d in (depth, moved)
    )

    np.testing.assert_array_equal(a.values, b.values)
    assert np.linalg.norm(a.anchor - b.anchor) > 0.05


def test_the_papers_literal_setting_can_be_configured(rig, sheet, observe):
    options = FeatureOptions(
        groups=("how",),
        foreground=ForegroundOptions(halve=False),
        how=HowOptions(
            channel="grey",
            align="center",
            sigma=6,
            wavelength=10,
            kernel_size=101,
            zero_mean=False,
            unit_norm=False,
            response="saturate8",
            normalise="none",
        ),
    )
    rng = np.random.default_rng(0)
    rgb = rng.integers(0, 255, sheet.rgb.shape).astype(np.uint8)
    frame = type(sheet)(0, rgb, sheet.depth, sheet.camera)

    extractor = Extractor(options, rig)
    features = extractor.extract(observe(frame))

    # The authors' programs: 8-bit filter2D of the grey picture, plain block sums.
    area = extractor.foreground(frame)
    grey = cv2.cvtColor(src=rgb, code=cv2.COLOR_RGB2GRAY)
    kernel = cv2.getGaborKernel(
        ksize=(101, 101), sigma=6.0, theta=0.0, lambd=10.0, gamma=0.5, psi=0.0
    )
    answer = cv2.filter2D(src=grey, ddepth=cv2.CV_8U, kernel=kernel.astype(np.float32))
    inside = (answer * area.mask)[150:330, 150:500].sum()
    assert features.values.max() > 1e4
    assert features.values[:192].sum() == pytest.approx(
        float((answer * area.mask).sum(dtype=np.float64)), rel=0.02
    )
    assert inside > 0


def test_relief_of_a_tilted_plane_is_flat(rig):
    extractor = Extractor(FeatureOptions(groups=("how",)), rig)
    from clothrf_core.testing.features import draw_sheet

    area = extractor.foreground(draw_sheet(rig))

    # A quadric fits the depth of a plane seen in perspective to a millimetre.
    assert np.abs(relief(area, "quadric")[area.mask]).max() < 4.0
    assert np.abs(relief(area, "median")[area.mask]).max() > 30.0
    assert How(HowOptions()).names == how_names(HowOptions())
