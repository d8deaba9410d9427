"""Arguments that PPO's learner refuses and accepts."""

import importlib.util

import pytest
import torch

from envs.core.errors import MissingExtraError, PolicyError
from policies.ppo.config import PpoConfig
from roboverse_learn.config.compose import compose
from roboverse_learn.training.config import TrainConfig
from roboverse_learn.training.rl.ppo import learner
from tests.roboverse_learn.training.rl.ppo.reach import Reach


def test_a_backend_that_is_not_installed_names_its_extra(monkeypatch):
    find = importlib.util.find_spec
    monkeypatch.setattr(importlib.util, "find_spec", lambda name: None if name == "rsl_rl" else find(name))
    message = r"backend=rsl_rl needs the package 'rsl_rl', .*pip install 'roboverse-learn\[rsl-rl\]'"
    with pytest.raises(MissingExtraError, match=message):
        learner.check_installed("rsl_rl")
    learner.check_installed("torchrl")


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


class Staggered(Reach):
    """Notes in which steps episodes end."""

    def __init__(self, num_envs: int) -> None:
        super().__init__(num_envs)
        self.ends: list[int] = []

    def stagger(self) -> None:
        self.elapsed_steps = torch.arange(self.num_envs) % self.max_episode_steps

    def step(self, actions):
        step = super().step(actions)
        self.ends.append(int(step.truncated.sum()))
        return step


@pytest.mark.slow
@pytest.mark.parametrize("stagger", [True, False])
def test_staggered_first_episodes_end_at_different_times(tmp_path, stagger):
    config = PpoConfig(backend="torchrl", num_envs=30, num_steps=4, num_minibatches=2, stagger=stagger)
    env = Staggered(30)
    train = TrainConfig(steps=30 * 20, save_every=10**6, num_threads=1)
    learner.train(config, env, train, tmp_path, "PickCube")
    assert any(env.ends) == stagger and max(env.ends) <= 1
