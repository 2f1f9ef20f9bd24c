"""Every registered component against the contract suite of its kind.

A plugin that needs a package, a driver or hardware that is absent skips itself, visibly.
"""

import numpy as np
import pytest

from clothrf_core.config import read_rig
from clothrf_core.errors import ClothrfError, ConfigError, FeatureMismatch, MissingDependency
from clothrf_core.interfaces import RenderedCamera
from clothrf_core.locations import shipped
from clothrf_core.params import Randomization, SimulationParams
from clothrf_core.provider import BuildContext
from clothrf_core.registry import KINDS, Registry
from clothrf_core.testing import camera as camera_suite
from clothrf_core.testing.arm_model import check_arm_model, check_bridge_end
from clothrf_core.testing.expert import check_expert
from clothrf_core.testing.features import check_feature_extractor, draw_sheet
from clothrf_core.testing.hands import check_hands
from clothrf_core.testing.policy import check_policy, synthetic_view
from clothrf_core.testing.randomizer import check_randomizer
from clothrf_core.testing.simulator import check_simulator

REGISTRY = Registry.installed()
RIG = read_rig(shipped("rigs/yumi_sr300.toml"))
CONTEXT = BuildContext(rig=RIG, registry=REGISTRY)


def names(kind):
    return REGISTRY.names(kind)


def maker(kind, name):
    def make():
        return REGISTRY.build(kind, name, None, CONTEXT)

    try:
        make()
    except (MissingDependency, ConfigError) as error:
        pytest.skip(str(error))
    except ClothrfError as error:
        if "in use" not in str(error):
            raise
        pytest.skip(str(error))
    except ValueError as error:
        pytest.skip(f"needs options: {error}")
    return make


def test_every_kind_has_a_component():
    assert {kind for kind in KINDS if not names(kind)} == set()


@pytest.mark.parametrize("name", names("simulator"))
def test_simulator(name):
    check_simulator(maker("simulator", name))


@pytest.mark.parametrize("name", names("camera"))
def test_camera(name):
    try:
        make = maker("camera", name)
    except ClothrfError as error:
        pytest.skip(str(error))
    if not isinstance(make(), RenderedCamera):
        pytest.skip(f"'{name}' reads pictures; its own tests give it some")
    camera_suite.check_rendered_camera(make)


@pytest.mark.parametrize("name", names("features"))
def test_features(name):
    check_feature_extractor(maker("features", name), RIG)


@pytest.mark.parametrize("name", names("policy"))
def test_policy(name):
    make = maker("policy", name)
    try:
        make().fit(synthetic_view(), np.random.default_rng(0))
    except FeatureMismatch as error:
        pytest.skip(f"its own tests give it the features it wants: {error}")
    check_policy(make)


@pytest.mark.parametrize("name", names("expert"))
def test_expert(name):
    check_expert(maker("expert", name))


@pytest.mark.parametrize("name", names("hands"))
def test_hands(name):
    check_hands(maker("hands", name))


@pytest.mark.parametrize("name", names("randomizer"))
def test_randomizer(name):
    start = SimulationParams(hands=RIG.rest_hands, grasp=RIG.rest_grasp)
    nominal = Randomization(simulation=start, camera=RIG.camera.model())
    check_randomizer(maker("randomizer", name), nominal, draw_sheet(RIG))


@pytest.mark.parametrize("name", names("arm"))
def test_arm(name):
    check_arm_model(maker("arm", name))


@pytest.mark.parametrize("name", names("bridge_end"))
def test_bridge_end(name):
    make = maker("bridge_end", name)
    arm = REGISTRY.build("arm", "yumi", None, CONTEXT)
    check_bridge_end(make, joints=len(arm.joint_names))


def test_the_simulated_robot_keeps_its_promises(toy, toy_experiment):
    from clothrf_core import compose, config
    from clothrf_core.testing.robot import check_robot

    shop = compose.workshop(config.load(toy_experiment, toy), toy)
    shop.world.reset(np.random.SeedSequence(0), shop.experts["ahead"])
    check_robot(lambda: shop.robot)
