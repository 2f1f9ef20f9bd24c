import numpy as np
import pytest

from clothrf_core.picture_distance import picture_distance
from clothrf_core.scene import Label, Picture, empty_picture
from clothrf_core.types import CameraModel, RgbdFrame

gymnasium = pytest.importorskip("gymnasium")


def picture(columns, depth):
    camera = CameraModel(20, 10, np.diag([20.0, 20.0, 1.0]), np.eye(4))
    labels = np.zeros((10, 20), np.uint8)
    labels[:, columns] = Label.CLOTH
    z = np.where(labels == Label.CLOTH, depth, np.nan).astype(np.float32)
    return Picture(RgbdFrame(0, np.zeros((10, 20, 3), np.uint8), z, camera), labels)


def test_equal_pictures_are_no_distance_apart():
    one = picture(slice(5, 15), 0.5)
    assert picture_distance(one, one) == 0.0


def test_pictures_without_common_cloth_are_one_apart():
    assert picture_distance(picture(slice(0, 5), 0.5), picture(slice(10, 15), 0.5)) == 1.0


def test_a_shift_in_depth_counts_in_proportion():
    near, far = picture(slice(5, 15), 0.50), picture(slice(5, 15), 0.51)
    assert np.isclose(picture_distance(near, far, saturation=0.05), 0.2, atol=1e-5)


def test_two_empty_pictures_say_nothing_good():
    nothing = empty_picture(picture(slice(0, 1), 1.0).frame.camera)
    assert picture_distance(nothing, nothing) == 1.0


@pytest.fixture(scope="module")
def environment():
    made = gymnasium.make("clothrf_gym.envs:ClothRF/Straight-v0", render_mode="rgb_array")
    yield made
    made.close()


@pytest.mark.filterwarnings("ignore:.*Box observation space.*infinity")
def test_it_passes_gymnasiums_checker(environment):
    from gymnasium.utils.env_checker import check_env

    check_env(environment.unwrapped, skip_render_check=False)


@pytest.mark.filterwarnings("ignore")
def test_it_passes_stable_baselines_checker(environment):
    checker = pytest.importorskip("stable_baselines3.common.env_checker")
    checker.check_env(environment.unwrapped, warn=False)


def test_every_task_has_an_id():
    gymnasium.make("clothrf_gym.envs:ClothRF/Bent-v0").close()
    ids = {name for name in gymnasium.registry if name.startswith("ClothRF/")}
    assert ids == {"ClothRF/Straight-v0", "ClothRF/Bent-v0", "ClothRF/Twisted-v0"}


def test_doing_nothing_costs_more_and_more_while_the_hands_move(environment):
    environment.reset(seed=3)
    rewards = [environment.step(np.zeros(6, np.float32))[1] for _ in range(60)]
    assert np.mean(rewards[-10:]) < np.mean(rewards[:5]) - 0.05


def test_following_the_expert_earns_the_highest_reward(environment):
    environment.reset(seed=3)
    inside = environment.unwrapped
    rewards = []
    for _ in range(40):
        state = inside._shop.world.state
        way = inside._shop.experts["straight"].label(state).targets - state.grasp
        action = np.clip(way / inside._reach, -1, 1).astype(np.float32).ravel()
        rewards.append(environment.step(action)[1])
    assert min(rewards) > -0.05


def test_equal_seeds_and_actions_give_equal_episodes(environment):
    runs = []
    for _ in range(2):
        environment.reset(seed=8)
        actions = np.random.default_rng(0).uniform(-1, 1, (10, 6)).astype(np.float32)
        runs.append([environment.step(action)[0] for action in actions])
    assert np.array_equal(runs[0], runs[1])


def test_an_unknown_task_is_named():
    with pytest.raises(Exception, match="has no task 'folded'; it has straight, bent, twisted"):
        gymnasium.make("clothrf_gym.envs:ClothRF/Straight-v0", task="folded")


def test_listing_the_plugin_does_not_register_anything():
    import subprocess
    import sys

    code = (
        "import clothrf_gym, gymnasium; "
        "print([n for n in gymnasium.registry if n.startswith('ClothRF')])"
    )
    run = subprocess.run([sys.executable, "-c", code], capture_output=True, text=True, check=True)
    assert run.stdout.strip() == "[]"
