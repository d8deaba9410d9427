"""What PPO has learned, as a policy."""

import json

import numpy as np
import pytest
import torch

import policies
from envs.core.errors import PolicyError
from policies import Policy
from policies.ppo.config import PpoConfig
from policies.ppo.network import EPS, RunningNorm
from policies.ppo.policy import PpoPolicy

KEY = "observation.environment_state"


@pytest.fixture
def policy():
    torch.manual_seed(0)
    made = PpoPolicy(PpoConfig(hidden_dims=(8, 8)), {KEY: 5}, 3)
    made.task = "PickCube"
    made.model.norm.update(torch.randn(50, 5) * 3 + 1)
    return made


def seen(count):
    return {KEY: np.random.default_rng(0).normal(size=(count, 5)).astype(np.float32)}


def test_it_is_a_policy(policy):
    assert isinstance(policy, Policy)
    assert policies.learns_from(policy.name) == "env"
    actions = policy.act(seen(4))
    assert actions.shape == (4, 1, 3) and actions.dtype == np.float32
    np.testing.assert_array_equal(actions[2:3], policy.act({KEY: seen(4)[KEY][2:3]}))


def test_loaded_policy_acts_the_same_and_has_its_task(policy, tmp_path):
    policy.save(tmp_path / "checkpoint")
    loaded = policies.load(tmp_path / "checkpoint")
    np.testing.assert_array_equal(loaded.act(seen(4)), policy.act(seen(4)))
    assert (loaded.task, loaded.config, loaded.n_params) == ("PickCube", policy.config, policy.n_params)
    assert {path.suffix for path in (tmp_path / "checkpoint").iterdir()} == {".json", ".safetensors"}


def test_another_observation_is_an_error(policy):
    with pytest.raises(PolicyError, match=r"policy 'ppo' was made for \(n, 5\). Use the task"):
        policy.act({KEY: np.zeros((1, 6))})


def test_a_damaged_checkpoint_is_an_error(policy, tmp_path):
    policy.save(tmp_path)
    path = tmp_path / "config.json"
    path.write_text(json.dumps(json.loads(path.read_text()) | {"config": {"hidden_dims": [8], "x": 1}}))
    with pytest.raises(PolicyError, match="is not a configuration of policy 'ppo'"):
        policies.load(tmp_path)
    path.write_text(json.dumps({"type": "act"}))
    with pytest.raises(PolicyError, match="of policy 'act', not of 'ppo'"):
        PpoPolicy.load(tmp_path)


def test_running_statistics_are_those_of_all_that_was_seen():
    norm, data = RunningNorm(3), torch.randn(300, 3) * torch.tensor([1.0, 5.0, 0.1]) + 7
    for part in (data[:10], data[10:200], data[200:]):
        norm.update(part)
    torch.testing.assert_close(norm.mean, data.mean(0))
    torch.testing.assert_close(norm.var, data.var(0, correction=0))
    torch.testing.assert_close(norm(data), (data - data.mean(0)) / (data.std(0, correction=0) + EPS))


def test_a_dataset_is_not_what_it_learns_from():
    with pytest.raises(PolicyError, match="'ppo' learns from an env, not from a dataset\\."):
        policies.create("ppo", {}, {})
