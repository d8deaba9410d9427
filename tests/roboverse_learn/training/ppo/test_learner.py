"""What the learner of PPO refuses, and what it is told."""

import importlib.util

import pytest

from envs.errors import ConfigError, MissingExtraError
from envs.tasks.pick_cube import PickCube
from policies import PolicyError
from policies.ppo.config import PpoConfig
from roboverse_learn.compose import compose
from roboverse_learn.training.config import TrainConfig
from roboverse_learn.training.ppo import learner


def test_a_backend_that_is_not_installed_names_its_extra(monkeypatch):
    find = importlib.util.find_spec
    monkeypatch.setattr(importlib.util, "find_spec", lambda name: None if name == "rsl_rl" else find(name))
    message = r"backend=rsl_rl needs the package 'rsl_rl', .*pip install 'roboverse-learn\[rsl-rl\]'"
    with pytest.raises(MissingExtraError, match=message):
        learner.check_installed("rsl_rl")
    learner.check_installed("torchrl")


def test_a_task_without_reward_is_refused(monkeypatch):
    learner.check_reward("PickCube", {})
    monkeypatch.setattr(PickCube, "has_reward", False)
    with pytest.raises(ConfigError, match=r"'PickCube' pays no reward, which policy=ppo learns from"):
        learner.check_reward("PickCube", {})


def test_events_come_after_whole_rollouts():
    config = learner.whole_rollouts(TrainConfig(steps=100, save_every=64, log_every=1), 32)
    assert (config.steps, config.save_every, config.log_every) == (128, 64, 32)


def test_the_command_line_reaches_ppo():
    config = compose("train", ["policy=ppo", "backend=sb3", "task=PickCube", "policy.num_envs=64", "lr=1e-3"])
    assert config.policy == PpoConfig(backend="sb3", num_envs=64)
    assert config.train.lr == 1e-3 and config.evaluate.levels == (0,)


@pytest.mark.parametrize(
    ("changes", "message"),
    [
        ({"backend": "jax"}, "backend must be one of rsl_rl, sb3, torchrl, given 'jax'"),
        ({"num_envs": 0}, "policy.num_envs must be above 0, given 0"),
        ({"gamma": 1.5}, "policy.gamma must be from 0 to 1, given 1.5"),
        ({"num_envs": 3, "num_steps": 5}, r"num_minibatches=8 does not divide a rollout of .*= 15 steps"),
        ({"hidden_dims": ()}, r"policy.hidden_dims needs a width per layer, given \[\]"),
    ],
)
def test_wrong_settings_are_named(changes, message):
    with pytest.raises(PolicyError, match=message):
        PpoConfig(**changes)
