from __future__ import annotations

import tomllib
from pathlib import Path

import clothrf_tasks
import numpy as np
import pytest
from clothrf_tasks.config import SequenceConfig, SequenceStep
from clothrf_tasks.directions import directions
from clothrf_tasks.experts import Bent, Straight, Twisted
from clothrf_tasks.sequence import build_sequence
from hypothesis import given
from hypothesis import strategies as st

from clothrf_core.errors import ConfigError, UnknownPlugin
from clothrf_core.provider import BuildContext
from clothrf_core.registry import Registry
from clothrf_core.rig import Rig
from clothrf_core.testing.expert import check_expert, cloth_state

RIG = Path(__file__).parents[3] / "configs" / "rigs" / "yumi_sr300.toml"

coordinate = st.floats(-0.1, 0.1)
hands_pose = st.lists(coordinate, min_size=6, max_size=6).map(
    lambda v: np.array(v).reshape(2, 3) + np.array([[0.63, -0.1, 0.3], [0.63, 0.1, 0.3]])
)


@pytest.fixture
def registry():
    return Registry.of(clothrf_tasks)


@pytest.fixture
def rig():
    return Rig.model_validate(tomllib.loads(RIG.read_text()))


@pytest.mark.parametrize("name", ["straight", "bent", "twisted", "sequence"])
def test_every_expert_keeps_the_contract(registry, name):
    check_expert(lambda: registry.build("expert", name, context=BuildContext(registry=registry)))


def test_the_printed_twist_asks_for_7_3_percent_too_much():
    check_expert(lambda: Twisted(twist="paper"), stretch=0.0741)
    with pytest.raises(AssertionError, match="side edge"):
        check_expert(lambda: Twisted(twist="paper"), stretch=0.07)


def test_c_points_from_the_hands_of_the_rig_to_its_robot(rig):
    state = cloth_state(rig.rest_hands, grasp=rig.rest_grasp)
    c = directions(state, eps=0.01).c
    to_robot = rig.rest_grasp.mean(axis=0) - rig.rest_hands.mean(axis=0)
    assert c[0] < -0.9
    assert c @ to_robot > 0.0


@given(hands_pose)
def test_straight_and_twisted_sides_are_exactly_the_length(hands):
    state = cloth_state(hands)
    for expert in (Straight(), Twisted()):
        sides = np.linalg.norm(expert.label(state).targets - hands, axis=1)
        np.testing.assert_allclose(sides, 0.35, atol=1e-12)


@given(hands_pose)
def test_the_grippers_are_as_far_apart_as_the_hands(hands):
    state = cloth_state(hands)
    width = np.linalg.norm(hands[1] - hands[0])
    for expert in (Straight(), Bent(), Twisted()):
        r0, r1 = expert.label(state).targets
        assert np.linalg.norm(r1 - r0) == pytest.approx(width, abs=1e-12)


def test_hands_too_far_apart_for_a_quarter_turn_still_keep_the_sides():
    hands = np.array([[0.6, -0.3, 0.3], [0.6, 0.3, 0.3]])
    sides = np.linalg.norm(Twisted().label(cloth_state(hands)).targets - hands, axis=1)
    np.testing.assert_allclose(sides, 0.35)


def test_labels_of_level_hands_are_the_printed_formulas():
    state = cloth_state(np.array([[0.6, -0.15, 0.3], [0.6, 0.15, 0.3]]))
    c, m = np.array([-1.0, 0, 0]), np.array([0.6, 0, 0.3])
    n = np.array([0.0, 0, 1])

    np.testing.assert_allclose(Straight().label(state).targets, state.hands + 0.35 * c)
    np.testing.assert_allclose(Bent().label(state).targets, state.hands + 0.175 * c)
    a = np.sqrt(0.35**2 - 0.3**2 / 2)
    twisted = np.stack([m + a * c + 0.15 * n, m + a * c - 0.15 * n])
    np.testing.assert_allclose(Twisted().label(state).targets, twisted)
    printed = np.stack([m + 0.31 * c + 0.15 * n, m + 0.31 * c - 0.15 * n])
    np.testing.assert_allclose(Twisted(twist="paper").label(state).targets, printed)


def test_the_expert_turns_with_the_hands():
    turn = np.array([[0.0, -1, 0], [1, 0, 0], [0, 0, 1]])
    hands = np.array([[0.6, -0.12, 0.28], [0.61, 0.15, 0.35]])
    for expert in (Straight(), Bent(), Twisted()):
        plain = expert.label(cloth_state(hands)).targets
        turned = expert.label(cloth_state(hands @ turn.T)).targets
        np.testing.assert_allclose(turned, plain @ turn.T, atol=1e-12)


def test_stacked_hands_hold_the_direction_in_which_the_grippers_stand():
    hands = np.array([[0.6, 0.0, 0.2], [0.6, 0.0, 0.4]])
    for angle in np.linspace(0, 2 * np.pi, 7):
        way = np.array([np.cos(angle), np.sin(angle), 0.0])
        state = cloth_state(hands, grasp=hands + 0.3 * way)
        np.testing.assert_allclose(directions(state, eps=0.01).c, way, atol=1e-12)


def test_c_has_no_jump_where_the_fall_back_begins():
    def c(ground):
        hands = np.array([[0.6, -ground / 2, 0.2], [0.6, ground / 2, 0.4]])
        grasp = hands + 0.3 * np.array([-0.8, 0.6, 0.0])
        return directions(cloth_state(hands, grasp=grasp), eps=0.01).c

    widths = np.linspace(1e-5, 0.02, 2000)
    steps = np.linalg.norm(np.diff([c(w) for w in widths], axis=0), axis=1)
    assert steps.max() < 0.003


@pytest.mark.parametrize("grasp_offset", [[0, 0, 0], [0, 0, 0.3], [-0.3, 0, 0]])
def test_touching_hands_have_a_label(grasp_offset):
    hands = np.full((2, 3), 0.4)
    state = cloth_state(hands, grasp=hands + np.array(grasp_offset, float))
    for expert in (Straight(), Bent(), Twisted(), Twisted(twist="paper")):
        assert np.isfinite(expert.label(state).targets).all()


def test_a_sequence_switches_at_its_times(registry):
    config = SequenceConfig(
        steps=[
            SequenceStep(plugin="bent"),
            SequenceStep(plugin="straight", start_s=2.0, options={"length": 0.3}),
        ],
        period_s=5.0,
    )
    expert = build_sequence(config, BuildContext(registry=registry))
    hands = np.array([[0.6, -0.15, 0.3], [0.6, 0.15, 0.3]])

    reach = {
        t: 0.6 - expert.label(cloth_state(hands, time_s=t)).targets[0, 0]
        for t in (0.0, 1.99, 2.0, 4.99, 5.0, 7.5)
    }

    assert reach == pytest.approx({0: 0.175, 1.99: 0.175, 2: 0.3, 4.99: 0.3, 5: 0.175, 7.5: 0.3})


def test_a_sequence_of_unknown_experts_names_the_nearest(registry):
    config = SequenceConfig(steps=[SequenceStep(plugin="strait")])
    with pytest.raises(UnknownPlugin, match="Did you mean 'straight'"):
        registry.build("expert", "sequence", config, BuildContext(registry=registry))


@pytest.mark.parametrize(
    ("config", "message"),
    [
        ({"steps": [{"plugin": "bent", "start_s": 1.0}]}, "rising from 0"),
        ({"steps": [{"plugin": "bent"}, {"plugin": "bent"}]}, "rising from 0"),
        (
            {"steps": [{"plugin": "bent"}, {"plugin": "bent", "start_s": 3.0}], "period_s": 2.0},
            "more than the last",
        ),
        ({"steps": [{"plugin": "bent", "options": {"lenght": 1}}]}, "lenght: Extra inputs"),
    ],
)
def test_a_wrong_sequence_says_what_is_wrong(registry, config, message):
    with pytest.raises(ConfigError, match=message):
        build_sequence(SequenceConfig.model_validate(config), BuildContext(registry=registry))
