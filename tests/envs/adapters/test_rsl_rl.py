"""rsl_rl's interface."""

import pytest
import torch

pytest.importorskip("rsl_rl")

from envs.adapters.rsl_rl import GROUP, RslRlVecEnv
from tests.envs.adapters.chain import Chain


def test_what_a_step_gives():
    env = RslRlVecEnv(Chain(3, 2))
    assert env.get_observations()[GROUP].tolist() == [[1, 0]] * 3
    assert (env.num_envs, env.num_actions, env.max_episode_length) == (3, 1, 2)
    obs, reward, dones, extras = env.step(torch.zeros(3, 1))
    assert obs.batch_size == (3,) and reward.tolist() == [1.0] * 3
    assert not dones.any() and not extras["time_outs"].any()
    assert env.get_observations()[GROUP].tolist() == [[0, 1]] * 3
    obs, _, dones, extras = env.step(torch.zeros(3, 1))
    assert dones.all() and extras["time_outs"].all()
    assert obs[GROUP].tolist() == extras["final_obs"][GROUP].tolist() == [[1, 0]] * 3


def test_an_end_is_no_time_out():
    env = RslRlVecEnv(Chain(3, 1, terminates=True))
    _, _, dones, extras = env.step(torch.zeros(3, 1))
    assert dones.all() and not extras["time_outs"].any()


def test_the_runner_may_stagger_episodes():
    chain = Chain(3, 5)
    env = RslRlVecEnv(chain)
    env.episode_length_buf = torch.tensor([4, 0, 1])
    _, _, dones, _ = env.step(torch.zeros(3, 1))
    assert dones.tolist() == [True, False, False]
    assert env.episode_length_buf.tolist() == [0, 1, 2]
