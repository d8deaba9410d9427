"""One environment as ``gymnasium.Env``: what LeRobot and other people's scripts are handed."""

import subprocess
import sys
from pathlib import Path

import gymnasium
import numpy as np
import pytest
from gymnasium.utils.env_checker import check_env

import envs
from envs.core.errors import ConfigError
from envs.gym_registration import gym_id, register_envs


@pytest.fixture(scope="module")
def env():
    env = envs.RoboVerseEnv("PickCube", split="test", image_size=32)
    yield env
    env.close()


def hold(env):
    return env.batch.get_states().robots["franka"].joint_pos[0].numpy().astype(np.float32)


@pytest.mark.filterwarnings("ignore:.*symmetric and normalized space:UserWarning")
@pytest.mark.parametrize("level", [pytest.param(0, marks=pytest.mark.long), 3])
def test_gymnasium_accepts_images_and_rendering(level):
    single = gymnasium.make(gym_id("PickCube"), level=level, image_size=32)
    check_env(single.unwrapped)
    single.close()


def test_an_episode_can_be_named(env):
    episode = int(env.batch.split_indices[5])
    observation, info = env.reset(options={"episode": episode})
    assert info == {"success": False, "is_success": False, "episode_index": episode}
    assert observation["agent_pos"].shape == (9,)
    assert observation["agent_pos"].dtype == np.float32
    assert env.task_description in env.batch.task.instructions


def test_equal_seeds_give_equal_episodes_and_later_ones_differ(env):
    def four_episodes():
        return [env.reset(seed=seed)[1]["episode_index"] for seed in (11, None, None, None)]

    episodes = four_episodes()
    assert four_episodes() == episodes
    assert len(set(episodes)) == 4
    assert set(episodes) <= set(env.batch.split_indices.tolist())


def test_an_episode_of_the_other_split_is_refused(env):
    with pytest.raises(ConfigError, match="is not in the split 'test'"):
        train = envs.make_vec("PickCube", 1, split="train", observation="state")
        episode = int(train.split_indices[0])
        train.close()
        env.reset(options={"episode": episode})


def test_a_step_gives_plain_numbers(env):
    env.reset(seed=0)
    observation, reward, terminated, truncated, info = env.step(hold(env))
    assert type(reward) is float
    assert 0.0 <= reward < 1.0
    assert (type(terminated), type(truncated)) == (bool, bool)
    assert info["success"] is info["is_success"] is False
    assert env.observation_space.contains(observation)


def test_images_of_one_row_are_rendered_when_read(env):
    observation, _ = env.reset(seed=1)
    pixels = observation["pixels"]
    assert not pixels.drawn
    seen = pixels["front"]
    for _ in range(5):
        env.step(env.action_space.low)
    np.testing.assert_array_equal(pixels["front"], seen)
    assert not np.array_equal(env.render(), seen)


def test_time_is_up_at_the_horizon_and_not_before(env):
    env.reset(seed=2)
    target = hold(env)
    ends = [env.step(target)[3] for _ in range(env._max_episode_steps)]
    assert ends == [False] * (env._max_episode_steps - 1) + [True]


def test_rendering_follows_the_mode():
    silent = envs.RoboVerseEnv("PickCube", render_mode=None, observation="state")
    silent.reset(seed=0)
    assert silent.render() is None
    assert silent.metadata["render_fps"] == 20
    silent.close()


def test_state_observations_need_no_camera():
    env = envs.RoboVerseEnv("PickCube", observation="state")
    observation, _ = env.reset(seed=3)
    assert set(observation) == {"agent_pos", "environment_state"}
    state = env.batch.get_states()
    np.testing.assert_allclose(observation["environment_state"][:3], state.objects["cube"].pos[0], atol=1e-6)
    env.close()


def test_registering_twice_is_harmless():
    register_envs()
    register_envs()


@pytest.mark.slow
def test_gymnasium_makes_tasks_after_one_import_at_most():
    code = (
        "import gymnasium\n"
        "for env_id in ('envs:RoboVerse/PickCube-v0', 'RoboVerse/PickCube-v0'):\n"
        "    env = gymnasium.make(env_id, observation='state')\n"
        "    assert env.reset(seed=0)[0]['agent_pos'].shape == (9,)\n"
        "    envs = gymnasium.make_vec(env_id, num_envs=2, observation='state')\n"
        "    assert envs.reset(seed=0)[0]['agent_pos'].shape == (2, 9)\n"
    )
    subprocess.run([sys.executable, "-c", code], check=True, cwd=Path(__file__).parents[2])


def test_a_task_that_is_not_there_is_gymnasiums_error_with_the_nearest():
    with pytest.raises(gymnasium.error.NameNotFound, match=r"Did you mean: `PickCube`\?"):
        gymnasium.make("RoboVerse/PickCub-v0")


def test_the_package_names_what_it_does_not_have():
    with pytest.raises(AttributeError, match="has no attribute 'RoboVersEnv'"):
        envs.RoboVersEnv  # noqa: B018 (the look-up is the test)


def test_a_task_of_a_family_has_an_id_that_gymnasium_takes():
    assert gym_id("PickCube") == "RoboVerse/PickCube-v0"
    assert gym_id("metaworld/pick-place-wall") == "RoboVerse/metaworld-pick-place-wall-v0"
    assert gym_id("metaworld/reach") in gymnasium.registry
    assert gym_id("metaworld/reach", state=True) == "RoboVerse/metaworld-reach-state-v0"


def test_the_id_of_the_state_shows_no_images():
    env = gymnasium.make(gym_id("PickCube", state=True))
    observation, _ = env.reset(seed=0)
    assert {key: value.ndim for key, value in observation.items()} == {"agent_pos": 1, "environment_state": 1}
    env.close()


def test_an_unknown_option_is_a_type_error_with_the_nearest():
    with pytest.raises(TypeError, match=r"unexpected keyword argument 'levle'\. Did you mean 'level'"):
        envs.make_vec("PickCube", levle=3)
