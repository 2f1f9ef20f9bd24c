"""What every feature extractor must keep to; call it with a function that builds yours."""

from __future__ import annotations

import dataclasses
from collections.abc import Callable

import numpy as np

from clothrf_core.camera_model import project
from clothrf_core.interfaces import FeatureExtractor
from clothrf_core.rig import Rig
from clothrf_core.types import Features, Float, GraspState, Observation, RgbdFrame


def check_feature_extractor(make: Callable[[], FeatureExtractor], rig: Rig) -> None:
    """Raise AssertionError at the first promise of `FeatureExtractor` that `make`'s breaks.

    Checked: names are there, unique and the same for every instance; values are finite float32, one
    a name; equal observations give equal bits, in any order and from a second instance; the
    observation is not changed; pictures without cloth (black, all NaN, a few pixels) give
    ``valid=False`` with zeros; holes, noise and a cloth that is cut off by the picture's border
    give finite numbers; the anchor lies near the cloth.

    Args:
        make: builds an extractor for `rig`; called more than once.
        rig: camera and corners that the pictures are drawn with.
    """
    extractor = make()
    names = extractor.names
    assert names, "an extractor must name its features"
    assert len(set(names)) == len(names), "feature names must be unique"
    assert make().names == names, "names must be the same for every instance"

    sheet = draw_sheet(rig)
    first = _extract(extractor, sheet)
    assert first.valid, "a sheet between the rest corners must give valid features"
    middle = np.concatenate([rig.rest_hands, rig.rest_grasp]).mean(axis=0)
    away = float(np.linalg.norm(first.anchor - middle))
    assert away < 0.15, f"the anchor must lie on the cloth, it is {away:.2f} m from its middle"

    for name, frame in _cloths(sheet).items():
        features = _extract(extractor, frame)
        assert features.valid, f"{name}: expected valid features"
        assert features.values.any(), f"{name}: all features are zero"
    for name, frame in _empties(sheet).items():
        features = _extract(extractor, frame)
        assert not features.valid, f"{name}: expected valid=False"
        assert not features.values.any(), f"{name}: values must be zero"
        assert not features.anchor.any(), f"{name}: the anchor must be zero"

    again = _extract(extractor, sheet)
    other = _extract(make(), sheet)
    for features in (again, other):
        assert features.values.tobytes() == first.values.tobytes(), "equal input, equal bits"
        assert features.anchor.tobytes() == first.anchor.tobytes(), "equal input, equal anchor"


def draw_sheet(rig: Rig) -> RgbdFrame:
    """A taut sheet between the rest corners of `rig`, with a bright colour on black."""
    camera = rig.camera.model()
    hands, grasp = rig.rest_hands, rig.rest_grasp
    # Dense enough that every pixel of the sheet is hit: half a pixel of the nearest corner.
    _, depths = project(camera, np.concatenate([hands, grasp]))
    pitch = 0.5 * float(depths.min()) / float(camera.K[0, 0])
    n = int(np.linalg.norm(hands[1] - hands[0]) / pitch) + 2
    m = int(np.linalg.norm(grasp[0] - hands[0]) / pitch) + 2
    u = np.linspace(0.0, 1.0, n)[None, :, None]
    v = np.linspace(0.0, 1.0, m)[:, None, None]
    near: Float = (1.0 - u) * hands[0] + u * hands[1]
    far: Float = (1.0 - u) * grasp[0] + u * grasp[1]
    points = ((1.0 - v) * near + v * far).reshape(-1, 3)
    pixels, z = project(camera, points)
    column, row = np.rint(pixels).astype(int).T
    inside = (column >= 0) & (column < camera.width) & (row >= 0) & (row < camera.height) & (z > 0)
    depth = np.full((camera.height, camera.width), np.inf, np.float32)
    np.minimum.at(depth, (row[inside], column[inside]), z[inside].astype(np.float32))
    depth[np.isinf(depth)] = np.nan
    rgb = np.zeros((camera.height, camera.width, 3), np.uint8)
    rgb[np.isfinite(depth)] = (30, 120, 130)
    return RgbdFrame(stamp_ns=1, rgb=rgb, depth=depth, camera=camera)


def _cloths(sheet: RgbdFrame) -> dict[str, RgbdFrame]:
    """The sheet as a sensor and a bad view may show it; all still show enough."""
    rng = np.random.default_rng(0)
    depth = np.array(sheet.depth)
    rows = np.flatnonzero(np.isfinite(depth).any(axis=1))
    columns = np.flatnonzero(np.isfinite(depth).any(axis=0))
    middle, centre = int(rows.mean()), int(columns.mean())
    noisy = depth + rng.normal(0.0, 3e-4, depth.shape).astype(np.float32)
    noisy[rng.random(depth.shape) < 0.05] = np.nan
    cut = depth.copy()
    cut[middle:] = np.nan
    side = depth.copy()
    side[:, :centre] = np.nan
    holed = depth.copy()
    holed[middle - 20 : middle + 20, centre - 20 : centre + 20] = np.nan
    cloths = {"noise and drop-outs": noisy, "lower half gone": cut, "left half gone": side}
    cloths["a hole in the middle"] = holed
    frames = {name: dataclasses.replace(sheet, depth=d) for name, d in cloths.items()}
    frames["no colour"] = dataclasses.replace(sheet, rgb=np.zeros_like(sheet.rgb))
    return frames


def _empties(sheet: RgbdFrame) -> dict[str, RgbdFrame]:
    depth = np.full_like(sheet.depth, np.nan)
    tiny = depth.copy()
    finite = np.argwhere(np.isfinite(sheet.depth))
    row, column = finite[len(finite) // 2]
    tiny[row : row + 3, column : column + 3] = sheet.depth[row, column]
    frames = {
        "nothing measured": depth,
        "nine pixels": tiny,
        "everything at zero": np.zeros_like(depth),
        "everything far away": np.full_like(depth, 100.0),
        "infinite depth": np.full_like(depth, np.inf),
    }
    black = np.zeros_like(sheet.rgb)
    return {name: dataclasses.replace(sheet, depth=d, rgb=black) for name, d in frames.items()}


def _extract(extractor: FeatureExtractor, frame: RgbdFrame) -> Features:
    before = frame.depth.tobytes(), frame.rgb.tobytes()
    observation = Observation(frame, GraspState(np.zeros((2, 3)), frame.stamp_ns))
    features = extractor.extract(observation)
    assert (frame.depth.tobytes(), frame.rgb.tobytes()) == before, "the picture was changed"
    assert features.names == extractor.names, "features must carry the extractor's names"
    assert features.values.dtype == np.float32, "values must be float32"
    assert np.isfinite(features.values).all(), "values must be finite"
    return features
