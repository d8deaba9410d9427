"""What holds of every policy that is registered."""

import json

import numpy as np
import pytest
import torch

import policies
from envs.core.errors import PolicyError
from policies import Policy
from tests.policies.examples import LEARNED, generators, make, observation

LIMITS = (np.full(9, -1.0), np.full(9, 2.0))


@pytest.fixture(scope="module", params=[*LEARNED, *policies.names("nothing")])
def policy(request):
    if policies.learns_from(request.param) == "nothing":
        return policies.policy_class(request.param)(*LIMITS, n_action_steps=3)
    return make(request.param)


def test_follows_the_protocol(policy):
    assert isinstance(policy, Policy)
    assert policies.summary(policy.name)


def test_returns_a_chunk_per_environment(policy):
    actions = policy.act(observation(policy, 3), generators(3))
    assert actions.shape == (3, policy.n_action_steps, 9)
    assert actions.dtype == np.float32
    assert np.isfinite(actions).all()


@pytest.mark.slow
def test_actions_do_not_depend_on_the_neighbours(policy):
    seen = observation(policy, 4)
    together = policy.act(seen, generators(4))
    alone = [
        policy.act({key: value[i : i + 1] for key, value in seen.items()}, generators(4)[i : i + 1])
        for i in range(4)
    ]
    np.testing.assert_array_equal(together, np.concatenate(alone))


def test_the_generators_are_the_only_source_of_noise(policy):
    seen = observation(policy, 2)
    torch.manual_seed(1)
    first = policy.act(seen, generators(2))
    torch.manual_seed(2)
    np.testing.assert_array_equal(first, policy.act(seen, generators(2)))


@pytest.mark.slow
def test_saved_and_loaded_acts_the_same(policy, tmp_path):
    seen = observation(policy, 2)
    expected = policy.act(seen, generators(2))
    policy.save(tmp_path / "checkpoint")
    loaded = type(policy).load(tmp_path / "checkpoint")
    np.testing.assert_array_equal(loaded.act(seen, generators(2)), expected)
    suffixes = {path.suffix for path in (tmp_path / "checkpoint").rglob("*")}
    assert suffixes <= {".json", ".safetensors"}
    assert [path.name for path in tmp_path.iterdir()] == ["checkpoint"]


@pytest.mark.slow
def test_saving_again_replaces_the_folder(policy, tmp_path):
    policy.save(tmp_path / "checkpoint")
    policy.save(tmp_path / "checkpoint")
    assert [path.name for path in tmp_path.iterdir()] == ["checkpoint"]


def test_an_observation_without_state_is_an_error(policy):
    seen = observation(policy, 1)
    del seen["observation.state"]
    with pytest.raises(PolicyError, match=r"no 'observation.state'.*needs. Given: observation.images.front"):
        policy.act(seen, generators(1))


@pytest.mark.slow
@pytest.mark.parametrize("name", LEARNED)
def test_load_finds_the_policy_and_accepts_a_run_folder(name, tmp_path):
    policy = make(name)
    policy.save(tmp_path / "run" / "checkpoints" / "last" / "pretrained_model")
    for folder in ("run", "run/checkpoints/last", "run/checkpoints/last/pretrained_model"):
        assert type(policies.load(tmp_path / folder)) is type(policy)


@pytest.mark.parametrize("name", policies.names("dataset"))
def test_a_config_of_defaults_can_be_made_without_torch(name):
    assert policies.config_class(name)()


def test_random_differs_between_generators_and_stays_within_limits():
    policy = policies.policy_class("random")(*LIMITS, n_action_steps=50)
    actions = policy.act(observation(policy, 2), generators(2))
    assert not np.array_equal(actions[0], actions[1])
    assert actions.min() >= -1.0 and actions.max() <= 2.0
    assert actions.std() > 0.5


def test_hold_returns_the_joint_positions():
    policy = policies.policy_class("hold")(np.full(9, -9.0), np.full(9, 9.0), n_action_steps=2)
    seen = observation(policy, 2)
    np.testing.assert_array_equal(policy.act(seen)[:, 1], seen["observation.state"])


def test_hold_names_the_sizes_that_differ():
    policy = policies.policy_class("hold")([-1.0], [1.0])
    with pytest.raises(PolicyError, match=r"'observation.state' is \(1, 9\), actions are \(1,\)"):
        policy.act(observation(policy, 1))


def test_scripted_limits_are_checked():
    with pytest.raises(PolicyError, match="low below high"):
        policies.policy_class("zero")([1.0], [0.0])


def test_scripted_checkpoint_of_another_rule_is_an_error(tmp_path):
    policies.policy_class("zero")(*LIMITS).save(tmp_path / "zero")
    with pytest.raises(PolicyError, match="is of policy 'zero', not of 'hold'"):
        policies.policy_class("hold").load(tmp_path / "zero")
    (tmp_path / "zero" / "scripted.json").write_text(json.dumps({"type": "zero"}))
    with pytest.raises(PolicyError, match="Write it again"):
        policies.policy_class("zero").load(tmp_path / "zero")
