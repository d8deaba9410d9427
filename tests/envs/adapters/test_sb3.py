"""Stable-Baselines3's interface, and what its own GAE makes of it."""

import numpy as np
import pytest
import torch

pytest.importorskip("stable_baselines3")

from stable_baselines3 import PPO
from stable_baselines3.common.callbacks import CallbackList
from stable_baselines3.common.logger import Logger

from envs.adapters.sb3 import Sb3VecEnv
from tests.envs.adapters.chain import GAMMA, Chain, value_of


def estimated(env: Chain, lam: float, steps: int = 6) -> tuple[torch.Tensor, np.ndarray, np.ndarray]:
    """Observations, returns and advantages of a rollout with an exact critic."""
    model = PPO(
        "MlpPolicy", Sb3VecEnv(env), n_steps=steps, batch_size=4, gamma=GAMMA, gae_lambda=lam, device="cpu",
        policy_kwargs={"net_arch": []},
    )  # fmt: skip
    with torch.no_grad():
        model.policy.value_net.weight.copy_(torch.tensor([[1.0, GAMMA]]) / (1 - GAMMA**2))
        model.policy.value_net.bias.zero_()
    model.set_logger(Logger(folder=None, output_formats=[]))  # its default leaves a folder in /tmp
    model._setup_learn(100)
    callback = CallbackList([])
    callback.init_callback(model)
    model.collect_rollouts(model.env, callback, model.rollout_buffer, steps)
    buffer = model.rollout_buffer
    return torch.from_numpy(buffer.observations), buffer.returns, buffer.advantages


@pytest.mark.parametrize("lam", [0.0, 0.5, 1.0])
@pytest.mark.parametrize("horizon", [1, 2, 3, 5])
def test_cut_off_episodes_have_the_value_of_endless_ones(lam, horizon):
    seen, returns, advantages = estimated(Chain(4, horizon), lam)
    np.testing.assert_allclose(returns[..., None], value_of(seen), rtol=1e-5)
    np.testing.assert_allclose(advantages, 0.0, atol=1e-5)


def test_terminated_episode_has_no_next_value():
    _, returns, _ = estimated(Chain(4, 3, terminates=True), 1.0)
    expected = [1 + GAMMA**2, GAMMA, 1.0] * 2
    np.testing.assert_allclose(returns, np.tile(np.array(expected)[:, None], (1, 4)), rtol=1e-5)


def test_steps_infos_and_attributes():
    chain = Chain(2, 2)
    env = Sb3VecEnv(chain)
    env.seed(5)
    np.testing.assert_array_equal(env.reset(), [[1, 0], [1, 0]])
    assert chain.seeds == [5]
    env.reset()
    assert chain.seeds == [5]
    assert env.reset_infos == [{}, {}]
    _, rewards, dones, infos = env.step(np.zeros((2, 1)))
    assert rewards.dtype == np.float32 and not dones.any() and infos == [{}, {}]
    obs, _, dones, infos = env.step(np.zeros((2, 1)))
    assert dones.all()
    np.testing.assert_array_equal(obs, [[1, 0], [1, 0]])
    np.testing.assert_array_equal(infos[0]["terminal_observation"], [1, 0])
    assert infos[0]["TimeLimit.truncated"] is True
    assert infos[1]["episode"] == {"r": 1.0, "l": 2, "t": 0.0}
    assert env.get_attr("max_episode_steps") == [2, 2]
    env.set_attr("max_episode_steps", 7)
    assert env.get_attr("max_episode_steps", 0) == [7]
    assert env.env_method("observe", indices=[1])[0].shape == (2, 2)
    assert env.env_is_wrapped(object) == [False, False]
    env.close()
    assert chain.closed
