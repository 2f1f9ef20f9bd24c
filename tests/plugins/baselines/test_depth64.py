from __future__ import annotations

import dataclasses
import tomllib
from pathlib import Path

import clothrf_baselines
import numpy as np
import pytest
from clothrf_baselines.config import DepthConfig, JoinedConfig
from clothrf_baselines.depth64 import Depth64, cells

from clothrf_core.errors import ConfigError, UnknownPlugin
from clothrf_core.provider import BuildContext
from clothrf_core.registry import Registry
from clothrf_core.rig import Rig
from clothrf_core.testing.features import check_feature_extractor, draw_sheet
from clothrf_core.types import GraspState, Observation

RIG = Rig.model_validate(
    tomllib.loads((Path(__file__).parents[3] / "configs" / "rigs" / "yumi_sr300.toml").read_text())
)
REGISTRY = Registry.of(clothrf_baselines)


def see(extractor, frame):
    return extractor.extract(Observation(frame, GraspState(RIG.rest_grasp, frame.stamp_ns)))


@pytest.mark.parametrize("grasp", [True, False])
def test_the_small_picture_keeps_the_contract(grasp):
    check_feature_extractor(lambda: Depth64(DepthConfig(grasp=grasp), RIG), RIG)


def test_cells_sum_the_whole_picture():
    picture = np.random.default_rng(0).random((480, 640)).astype(np.float32)
    found = cells(picture)
    assert found.shape == (64, 64)
    assert found.sum() == pytest.approx(picture.sum(), rel=1e-5)
    assert found[0, 0] == pytest.approx(picture[:7, :10].sum(), rel=1e-5)
    assert found[63, 63] == pytest.approx(picture[472:, 630:].sum(), rel=1e-5)


def test_values_are_metres_where_the_cloth_is_and_zero_elsewhere():
    frame = draw_sheet(RIG)
    picture = see(Depth64(DepthConfig(), RIG), frame).values[:4096].reshape(64, 64)
    inside = picture > 0
    assert 0.05 < inside.mean() < 0.7
    assert 0.3 < picture[inside].min() < picture[inside].max() < 0.8
    full = cells(np.nan_to_num(frame.depth)) > 0
    assert np.array_equal(inside, full)


def test_grippers_are_the_last_six_numbers():
    values = see(Depth64(DepthConfig(), RIG), draw_sheet(RIG)).values
    np.testing.assert_allclose(values[4096:].reshape(2, 3), RIG.rest_grasp, atol=1e-6)


def test_what_lies_outside_the_workspace_is_not_cloth():
    frame = draw_sheet(RIG)
    depth = np.array(frame.depth)
    depth[:60, :60] = 0.85  # in range, but beyond the box
    cluttered = dataclasses.replace(frame, depth=depth)
    extractor = Depth64(DepthConfig(), RIG)
    assert see(extractor, cluttered).values[0] == 0.0


def test_a_hue_in_the_rig_keeps_other_colours_out():
    frame = draw_sheet(RIG)
    rgb = np.array(frame.rgb)
    rgb[:, :320] = (200, 60, 40)
    part = dataclasses.replace(frame, rgb=rgb)
    section = RIG.foreground.model_copy(update={"hue": [170.0, 200.0]})
    extractor = Depth64(DepthConfig(), RIG.model_copy(update={"foreground": section}))
    picture = see(extractor, part).values[:4096].reshape(64, 64)
    assert not picture[:, :32].any()
    assert picture[:, 32:].any()


def test_joined_parts_stand_one_after_the_other():
    config = JoinedConfig.model_validate(
        {"parts": [{"plugin": "depth64", "options": {"grasp": False}}]}
    )
    context = BuildContext(rig=RIG, registry=REGISTRY)
    joined = REGISTRY.build("features", "joined", config, context)
    alone = Depth64(DepthConfig(grasp=False), RIG)
    frame = draw_sheet(RIG)
    assert joined.names == alone.names
    assert np.array_equal(see(joined, frame).values, see(alone, frame).values)
    check_feature_extractor(lambda: REGISTRY.build("features", "joined", config, context), RIG)


@pytest.mark.parametrize(
    ("parts", "error", "message"),
    [
        ([{"plugin": "depht64"}], UnknownPlugin, "Did you mean 'depth64'"),
        ([{"plugin": "depth64", "options": {"gras": 1}}], ConfigError, "gras: Extra inputs"),
        ([{"plugin": "depth64"}, {"plugin": "depth64"}], ConfigError, "got some twice"),
    ],
)
def test_wrong_parts_say_what_is_wrong(parts, error, message):
    config = JoinedConfig.model_validate({"parts": parts})
    with pytest.raises(error, match=message):
        REGISTRY.build("features", "joined", config, BuildContext(rig=RIG, registry=REGISTRY))
