"""A network of a user, from its class to actions of the robot."""

from dataclasses import dataclass

import numpy as np
import pytest
import torch
from torch import nn

import policies
from envs.core.errors import PolicyError
from policies.module_policy import module_policy
from policies.trainable import TrainablePolicy
from roboverse_learn.config.compose import compose
from tests.policies.examples import FEATURES, generators, observation, stats


@dataclass(frozen=True, kw_only=True)
class LinearConfig:
    """Settings.

    Attributes:
        chunk_size: Actions of a chunk.
    """

    chunk_size: int = 4
    n_action_steps: int = 2
    n_obs_steps: int = 1
    widths: tuple[int, ...] = (8,)


class Linear(TrainablePolicy):
    config_class = LinearConfig

    def __init__(self, config, shapes):
        super().__init__(config, shapes)
        (state,), (action,) = shapes["observation.state"], shapes["action"]
        self.net = nn.Sequential(
            nn.Flatten(),
            nn.Linear(config.n_obs_steps * state, config.chunk_size * action),
            nn.Unflatten(1, (config.chunk_size, action)),
        )
        self.tied = self.net

    def compute_loss(self, batch):
        loss = (self.act(batch) - batch["action"]).abs().mean()
        return loss, {"twice": 2.0 * loss}

    def act(self, observation):
        return self.net(observation["observation.state"])


class Noise(Linear):
    def act(self, observation):
        return torch.randn(len(observation["observation.state"]), 4, 9)


class Mean(Linear):
    def act(self, observation):
        return torch.zeros(len(observation["observation.state"]), 4, 9)


@pytest.fixture
def registered(monkeypatch):
    """Registers classes for one test."""

    def add(**classes):
        monkeypatch.setattr(policies.POLICIES, "_entries", dict(policies.POLICIES._entries))
        for name, found in classes.items():
            policies.POLICIES.add(name, found)

    return add


def make(cls, **changes):
    policy = module_policy("mine", cls).create(FEATURES, stats(), cls.config_class(**changes), "cpu")
    assert isinstance(policy, policies.Policy)
    return policy


@pytest.mark.parametrize("n_obs_steps", [1, 3])
def test_saved_and_loaded_it_acts_the_same(registered, tmp_path, n_obs_steps):
    registered(mine=f"{__name__}:Linear")
    config = LinearConfig(n_obs_steps=n_obs_steps, widths=(3, 5))
    policy = policies.create("mine", FEATURES, stats(), config)
    seen = observation(policy, 3)
    expected = policy.act(seen, generators(3))
    assert expected.shape == (3, 2, 9) and expected.dtype == np.float32
    policy.save(tmp_path)
    assert sorted(path.suffix for path in tmp_path.iterdir()) == [".json", ".json", ".safetensors"]
    loaded = policies.load(tmp_path)
    np.testing.assert_array_equal(loaded.act(seen, generators(3)), expected)
    assert loaded.name == "mine" and loaded.model.config == config
    assert Linear.load(tmp_path).shapes["observation.images.front"] == (3, 32, 32)


def test_its_dataclass_is_its_keys(registered):
    registered(mine=Linear)
    config = compose("train", ["policy=mine", "preset=quick", "policy.widths=[3,5]", "chunk_size=7"])
    assert config.policy == LinearConfig(chunk_size=7, widths=(3, 5))
    assert policies.learns_from("mine") == "dataset" and "mine" in policies.names()


def test_batches_are_normalized_and_actions_are_in_units_of_the_robot():
    seen = observation(make(Mean), 1)
    np.testing.assert_allclose(make(Mean).act(seen)[0, 0], stats()["action"]["mean"], rtol=1e-6)
    policy = make(Linear)
    frame = torch.as_tensor(stats()["observation.state"]["mean"] + stats()["observation.state"]["std"])
    image = torch.full((1, 3, 2, 2), 255, dtype=torch.uint8)
    batch = policy.preprocess({"observation.state": frame[None], "observation.images.front": image})
    torch.testing.assert_close(batch["observation.state"], torch.ones(1, 9))
    assert batch["observation.images.front"].equal(torch.ones(1, 3, 2, 2))


def test_loss_and_its_numbers_are_tensors():
    raw = {"observation.state": torch.rand(2, 9), "action": torch.rand(2, 4, 9)}
    loss, terms = make(Linear).objective()(raw)
    assert loss.requires_grad and terms["twice"] == 2.0 * loss and not terms["twice"].requires_grad


def test_noise_is_that_of_the_episode():
    policy = make(Noise)
    seen = observation(policy, 2)
    first = policy.act(seen, generators(2))
    torch.manual_seed(5)
    np.testing.assert_array_equal(policy.act(seen, generators(2)), first)
    assert not np.array_equal(first[0], first[1])


def test_an_act_of_the_wrong_shape_is_an_error(monkeypatch):
    policy = make(Linear)
    monkeypatch.setattr(Linear, "act", lambda self, seen: torch.zeros(1, 9))
    with pytest.raises(PolicyError, match=r"Linear.act returned .* \(1, 9\); it must be \(1, T, 9\) with T"):
        policy.act(observation(policy, 1))


@pytest.mark.parametrize("loss", [None, torch.zeros(3), torch.zeros(())])
def test_a_loss_that_is_no_scalar_of_the_parameters_is_an_error(monkeypatch, loss):
    monkeypatch.setattr(Linear, "compute_loss", lambda self, batch: loss)
    with pytest.raises(PolicyError, match=r"Linear.compute_loss returned .* must be a scalar"):
        make(Linear).loss({})


def test_more_executed_than_predicted_actions_are_an_error():
    with pytest.raises(PolicyError, match=r"policy.n_action_steps=5 must be from 1 to policy.chunk_size=4"):
        make(Linear, n_action_steps=5)


@dataclass
class WithoutDefault:
    width: int


@pytest.mark.parametrize(
    ("found", "message"),
    [
        (nn.Linear, "registered as Linear, which is no subclass of policies.trainable.TrainablePolicy"),
        (type("Bare", (TrainablePolicy,), {}), "config_class is None. Set it to a frozen dataclass"),
        (type("Bare", (Linear,), {"config_class": WithoutDefault}), "WithoutDefault has no default of width"),
    ],
)
def test_what_is_no_policy_is_an_error(registered, found, message):
    registered(mine=found)
    with pytest.raises(PolicyError, match=message):
        policies.config_class("mine")
