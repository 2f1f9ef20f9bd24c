from __future__ import annotations

import itertools
import tomllib
from pathlib import Path

import clothrf_tasks
import numpy as np
import pytest
from clothrf_tasks.config import ScriptedConfig, StillConfig, TargetsConfig

from clothrf_core.errors import ConfigError
from clothrf_core.provider import BuildContext
from clothrf_core.registry import Registry
from clothrf_core.rig import Rig
from clothrf_core.testing.hands import check_hands

RIG = Path(__file__).parents[3] / "configs" / "rigs" / "yumi_sr300.toml"
RNG = np.random.default_rng


@pytest.fixture
def context():
    return BuildContext(rig=Rig.model_validate(tomllib.loads(RIG.read_text())))


def build(name, config, context):
    return Registry.of(clothrf_tasks).build("hands", name, config, context)


@pytest.mark.parametrize("name", ["targets", "scripted", "still"])
def test_every_motion_keeps_the_contract(name, context):
    check_hands(lambda: build(name, None, context))


@pytest.mark.parametrize("options", [{"pairing": "common"}, {"pause_s": 0.5}, {"range": [0, 0, 0]}])
def test_variants_of_the_targets_keep_the_contract(options, context):
    if options.get("range"):
        options |= {"rest": [[0.6, -0.1, 0.3], [0.6, 0.1, 0.3]]}
    check_hands(lambda: build("targets", TargetsConfig.model_validate(options), context))


def test_limits_of_the_config_win_over_the_rig(context):
    config = TargetsConfig(max_distance=0.2, max_speed=0.03)
    check_hands(
        lambda: build("targets", config, context), max_distance=0.2, max_speed=0.03, seconds=30
    )


def test_targets_stay_in_range_and_uncrossed(context):
    motion = build("targets", None, context)
    poses = np.array([motion.reset(RNG(i)) for i in range(400)])
    offsets = poses - context.rig.rest_hands

    assert np.abs(offsets).max() <= 0.1
    assert (poses[:, 1, 1] - poses[:, 0, 1]).min() > 0.0
    # The distance limit rejects wide pairs only; along x and z the draw stays uniform about rest.
    assert np.abs(offsets[..., 2].mean(axis=0)).max() < 0.02
    assert np.abs(offsets).max() > 0.098


def test_the_hands_move_as_fast_as_allowed_and_arrive_together(context):
    motion = build("targets", None, context)
    motion.reset(RNG(3))
    poses = np.array([motion.step(1 / 30) for _ in range(600)])
    steps = np.abs(np.diff(poses, axis=0)).max(axis=(1, 2)) * 30

    assert np.quantile(steps, 0.1) == pytest.approx(0.1, rel=1e-6)
    directions = np.diff(poses, axis=0).reshape(-1, 6)
    directions /= np.linalg.norm(directions, axis=1, keepdims=True)
    turns = np.sum(directions[1:] * directions[:-1], axis=1) < 1 - 1e-9
    assert 5 < turns.sum() < 80  # straight lines, both hands turning at the same instants


def test_two_half_steps_are_one_step(context):
    one, two = build("targets", None, context), build("targets", None, context)
    one.reset(RNG(5))
    two.reset(RNG(5))
    for _ in range(200):
        two.step(0.05)
        np.testing.assert_allclose(one.step(0.1), two.step(0.05), atol=1e-12)


def test_a_pause_is_spent_standing(context):
    motion = build("targets", TargetsConfig(pause_s=1.0), context)
    poses = [motion.reset(RNG(1))] + [motion.step(0.1) for _ in range(600)]
    still = [np.array_equal(a, b) for a, b in itertools.pairwise(poses)]
    assert 0.2 < np.mean(still) < 0.8


def test_common_pairing_keeps_the_shape_of_the_pair(context):
    motion = build("targets", TargetsConfig(pairing="common"), context)
    poses = np.array([motion.reset(RNG(1))] + [motion.step(0.1) for _ in range(100)])
    spread = (poses[:, 1] - poses[:, 0]).std(axis=0)
    np.testing.assert_allclose(spread, 0.0, atol=1e-12)


def test_still_hands_are_the_rest_corners_drawn_together(context):
    pose = build("still", None, context).reset(RNG(0))
    rest = context.rig.rest_hands
    np.testing.assert_allclose(pose.mean(axis=0), rest.mean(axis=0))
    assert np.linalg.norm(pose[1] - pose[0]) == pytest.approx(0.30)


def test_a_script_passes_through_its_poses(context):
    hands = [[[0.6, -0.1, 0.3], [0.6, 0.1, 0.3]], [[0.6, -0.1, 0.4], [0.6, 0.1, 0.35]]]
    config = ScriptedConfig.model_validate(
        {
            "frame": "world",
            "poses": [
                {"time_s": 0.0, "hands": hands[0]},
                {"time_s": 1.0, "hands": hands[1]},
                {"time_s": 2.0, "hands": hands[0]},
            ],
            "repeat": True,
        }
    )
    motion = build("scripted", config, context)

    poses = [motion.reset(RNG(0))] + [motion.step(0.5) for _ in range(6)]

    for index, height in enumerate([0.3, 0.35, 0.4, 0.35, 0.3, 0.35, 0.4]):
        assert poses[index][0, 2] == pytest.approx(height)


@pytest.mark.parametrize(
    ("name", "config", "message"),
    [
        ("scripted", ScriptedConfig(max_speed=0.01), "allow more time"),
        ("scripted", ScriptedConfig(frame="world"), "uncrossed"),
        ("still", StillConfig(hands=[[0.6, -0.2, 0.3], [0.6, 0.2, 0.3]]), "at most 0.3 m apart"),
        ("still", StillConfig(hands=[[0.6, 0.1, 0.3], [0.6, -0.1, 0.3]]), "uncrossed"),
    ],
)
def test_an_illegal_pose_is_refused(name, config, message, context):
    with pytest.raises(ConfigError, match=message):
        build(name, config, context)


def test_impossible_targets_are_refused(context):
    motion = build("targets", TargetsConfig(max_distance=0.05, range=[0.01] * 3), context)
    with pytest.raises(ConfigError, match="widen 'range' or 'max_distance'"):
        motion.reset(RNG(0))


def test_without_a_rig_the_rest_corners_must_be_given():
    with pytest.raises(ConfigError, match="name a rig or give 'rest'"):
        build("targets", None, BuildContext())
