"""LeRobot's view: what its config says, what its evaluation calls."""

from dataclasses import dataclass

import draccus
import numpy as np
import pytest
from lerobot.configs import FeatureType
from lerobot.envs import EnvConfig, make_env
from lerobot.envs.utils import preprocess_observation

from envs.core.errors import UnknownNameError
from envs.lerobot import RoboVerseEnvConfig
from envs.spec import EnvSpec
from envs.vector_env import RoboVerseVectorEnv


@dataclass
class Command:
    """What LeRobot's commands read ``--env.type`` into."""

    env: EnvConfig


@pytest.fixture(scope="module")
def env():
    config = RoboVerseEnvConfig(task="PickCube", image_size=32)
    env = config.create_envs(2)["roboverse"][0]
    yield env
    env.close()


def test_its_name_is_roboverse():
    assert EnvConfig.get_choice_class("roboverse") is RoboVerseEnvConfig
    assert RoboVerseEnvConfig().type == "roboverse"


def test_features_say_what_the_env_gives():
    config = RoboVerseEnvConfig(task="PickCube", image_size=64)
    assert {name: (feature.type, feature.shape) for name, feature in config.features.items()} == {
        "action": (FeatureType.ACTION, (9,)),
        "agent_pos": (FeatureType.STATE, (9,)),
        "pixels/front": (FeatureType.VISUAL, (64, 64, 3)),
    }
    assert config.features_map == {
        "action": "action",
        "agent_pos": "observation.state",
        "pixels/front": "observation.images.front",
    }
    assert config.fps == 20


def test_options_reach_the_env():
    spec = EnvSpec(only="camera", renderer="mujoco", image_size=48, simulator_settings={"impratio": 5.0})
    config = RoboVerseEnvConfig(**spec.to_json(), split="train")
    assert config.spec == spec
    assert config.gym_kwargs.items() >= {"only": "camera", "split": "train", "image_size": 48}.items()
    assert "task" not in config.gym_kwargs
    env = config.create_envs(1)["roboverse"][0]
    assert env.env_spec == spec and env.handler.physics_model.opt.impratio == 5.0
    env.close()


def test_a_task_that_does_not_exist_is_refused_at_once():
    with pytest.raises(UnknownNameError, match=r"Unknown task 'PickKube'\. Did you mean 'PickCube'\?"):
        RoboVerseEnvConfig(task="PickKube")


def test_it_is_read_from_a_command_line():
    given = ["--env.type=roboverse", "--env.task=PickCube", "--env.level=2", "--env.image_size=96"]
    given += ["--env.cameras=[wrist,front]", "--env.task_kwargs={variant: lift}"]
    config = draccus.parse(Command, args=given).env
    assert isinstance(config, RoboVerseEnvConfig)
    assert (config.level, config.image_size, config.cameras) == (2, 96, ("wrist", "front"))
    assert config.spec.make_task().variant == "lift"
    assert config.features["pixels/front"].shape == (96, 96, 3)


def test_lerobot_makes_it_by_its_own_function():
    made = make_env(RoboVerseEnvConfig(image_size=32), n_envs=1)["roboverse"][0]
    assert isinstance(made, RoboVerseVectorEnv)
    assert made.num_envs == 1
    made.close()


def test_calls_that_evaluation_makes(env):
    env.reset(seed=0)
    assert env.call("_max_episode_steps") == (100, 100)
    assert env.call("task") == ("PickCube", "PickCube")
    words = env.call("task_description")
    assert len(words) == 2
    assert set(words) <= set(env.task.instructions)
    frames = env.call("render")
    assert [frame.shape for frame in frames] == [(32, 32, 3)] * 2
    assert frames[0].dtype == np.uint8


def test_the_language_channel_gives_held_out_words():
    env = RoboVerseEnvConfig(image_size=16, only="language").create_envs(2)["roboverse"][0]
    env.reset(seed=0)
    held_out = env.task.wordings(env.task.description).test
    assert {*env.call("task_description")} <= {*held_out}
    env.close()


def test_another_call_is_refused_by_name(env):
    with pytest.raises(AttributeError, match="RoboVerse's vector env has no 'fly' to call"):
        env.call("fly")


def test_observations_pass_lerobots_preprocessing(env):
    observation, _ = env.reset(seed=1)
    batch = preprocess_observation(observation)
    assert tuple(batch["observation.state"].shape) == (2, 9)
    assert tuple(batch["observation.images.front"].shape) == (2, 3, 32, 32)
    assert float(batch["observation.images.front"].min()) >= 0.0
    assert float(batch["observation.images.front"].max()) <= 1.0


def test_a_step_ends_episodes_the_way_evaluation_reads_them(env):
    """An episode that is over starts again in the same step, and its last info is kept."""
    env.reset(seed=2)
    env.elapsed_steps[:] = [env.task.max_episode_steps - 1, 0]
    hold = env.get_states().robots["franka"].joint_pos.numpy()
    _, reward, terminated, truncated, info = env.step(hold)
    assert reward.shape == (2,)
    assert terminated.tolist() == [False, False]
    assert truncated.tolist() == [True, False]
    assert info["final_info"]["is_success"].tolist() == [False, False]
    assert env.elapsed_steps.tolist() == [0, 1]
