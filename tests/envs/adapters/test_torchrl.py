"""TorchRL's interface, and what its own GAE makes of it."""

import pytest
import torch

pytest.importorskip("torchrl")

from tensordict.nn import TensorDictModule
from torchrl.envs.utils import check_env_specs
from torchrl.objectives.value import GAE

from envs.adapters.torchrl import TorchRlEnv
from tests.envs.adapters.chain import GAMMA, Chain, value_of


def rollout(env: Chain, steps: int = 6):
    return TorchRlEnv(env).rollout(steps, break_when_any_done=False)


def with_returns(data, lam):
    critic = TensorDictModule(value_of, ["observation"], ["state_value"])
    with torch.no_grad():
        return GAE(gamma=GAMMA, lmbda=lam, value_network=critic, average_gae=False)(data)


@pytest.mark.slow
def test_the_specs_hold():
    check_env_specs(TorchRlEnv(Chain(3, 4)))
    check_env_specs(TorchRlEnv(Chain(3, 2, terminates=True)))


@pytest.mark.parametrize("lam", [0.0, 0.5, 1.0])
@pytest.mark.parametrize("horizon", [1, 2, 3, 5])
def test_cut_off_episodes_have_the_value_of_endless_ones(lam, horizon):
    data = with_returns(rollout(Chain(4, horizon)), lam)
    torch.testing.assert_close(data["value_target"], value_of(data["observation"]))
    torch.testing.assert_close(data["advantage"], torch.zeros(4, 6, 1), atol=1e-5, rtol=0)


def test_terminated_episode_has_no_next_value():
    data = with_returns(rollout(Chain(4, 3, terminates=True)), 1.0)
    expected = torch.tensor([1 + GAMMA**2, GAMMA, 1.0] * 2).expand(4, 6)
    torch.testing.assert_close(data["value_target"][..., 0], expected)


def test_a_step_shows_the_end_of_an_episode_and_the_reset_the_next_one():
    data = rollout(Chain(1, 3))
    ends = data["next", "truncated"][0, :, 0]
    assert ends.tolist() == [False, False, True] * 2
    assert data["next", "observation"][0, 2].tolist() == [0, 1]
    assert data["observation"][0, 3].tolist() == [1, 0]
    assert not data["next", "terminated"].any()


def test_an_episode_that_is_not_over_can_be_reset_alone():
    chain = Chain(2, 10)
    env = TorchRlEnv(chain)
    after = env.step(env.reset().set("action", torch.zeros(2, 1)))["next"]
    after["_reset"] = torch.tensor([[True], [False]])
    assert env.reset(after)["observation"].tolist() == [[1, 0], [0, 1]]
    assert chain.elapsed_steps.tolist() == [0, 1]


def test_a_seed_reaches_the_env():
    chain = Chain(2)
    TorchRlEnv(chain).set_seed(11)
    assert chain.seeds == [11]
