"""A trained TD-MPC2 as a policy: acting, saving, loading."""

import json
from dataclasses import replace

import numpy as np
import pytest
import torch

from envs.core.errors import PolicyError
from policies import Policy
from policies.checkpoint import seen_cameras
from policies.tdmpc2.config import Tdmpc2Config
from policies.tdmpc2.policy import Tdmpc2Policy

SIZES = {"observation.state": 4, "observation.environment_state": 3}
CONFIG = Tdmpc2Config(
    model_size=1,
    enc_dim=16,
    mlp_dim=16,
    latent_dim=16,
    num_bins=21,
    num_samples=16,
    num_elites=4,
    num_pi_trajs=2,
)


def make(**changes) -> Tdmpc2Policy:
    return Tdmpc2Policy.create(replace(CONFIG, **changes), SIZES, 2, 100)


def observation(n: int):
    rng = np.random.default_rng(0)
    return {key: rng.normal(size=(n, size)).astype(np.float32) for key, size in SIZES.items()}


def generators(n: int):
    return [torch.Generator().manual_seed(i) for i in range(n)]


@pytest.mark.slow
@pytest.mark.parametrize("plan", [True, False])
def test_acts_alike_alone_and_after_loading(plan, tmp_path):
    policy, seen = make(plan=plan), observation(3)
    assert isinstance(policy, Policy)
    actions = policy.act(seen, generators(3))
    assert actions.shape == (3, 1, 2) and actions.dtype == np.float32 and np.abs(actions).max() <= 1.0
    alone = policy.act({key: value[1:2] for key, value in seen.items()}, generators(3)[1:2])
    np.testing.assert_array_equal(actions[1:2], alone)
    policy.save(tmp_path / "it")
    saved = {path.name for path in (tmp_path / "it").iterdir()}
    assert saved == {"config.json", "model.safetensors", "sha256.json"}
    loaded = Tdmpc2Policy.load(tmp_path / "it")
    np.testing.assert_array_equal(loaded.act(seen, generators(3)), actions)
    assert (loaded.config, loaded.discount) == (policy.config, 0.95)


def test_together_samples_differ_by_rounding_alone():
    policy, seen = make(), observation(3)
    expected = policy.act(seen, generators(3))
    policy.batch_invariant = False
    np.testing.assert_allclose(policy.act(seen, generators(3)), expected, atol=1e-4)


def test_first_weights_depend_on_the_seed_alone():
    weights = [Tdmpc2Policy.create(CONFIG, SIZES, 2, 100, seed=seed).state_dict() for seed in (1, 1, 2)]
    key = "dynamics.0.weight"
    assert weights[0][key].equal(weights[1][key]) and not weights[0][key].equal(weights[2][key])


def test_wrong_observations_and_generators_are_errors():
    policy = make()
    with pytest.raises(PolicyError, match=r"no 'observation.environment_state', which policy 'tdmpc2' needs"):
        policy.act({"observation.state": np.zeros((1, 4))})
    with pytest.raises(PolicyError, match=r"'observation.state' has shape \(1, 9\).*made for \(n, 4\)"):
        policy.act(observation(1) | {"observation.state": np.zeros((1, 9))})
    with pytest.raises(PolicyError, match="one generator per environment: 2, given 1"):
        policy.act(observation(2), generators(1))


CAMERAS = {"observation.images.front": 64, "observation.images.wrist": 64}


def film(n: int):
    rng = np.random.default_rng(0)
    return {key: rng.integers(0, 256, (n, 3, 64, 64, 3), np.uint8) for key in CAMERAS}


def test_pixel_policy_stacks_three_frames_and_loads_its_cameras(tmp_path):
    config = replace(CONFIG, observation="pixels", num_channels=4)
    policy, seen = Tdmpc2Policy.create(config, CAMERAS, 2, 100), film(2)
    assert policy.n_obs_steps == 3 and make().n_obs_steps == 1
    actions = policy.act(seen, generators(2))
    np.testing.assert_array_equal(policy.act(seen, generators(2)), actions)
    policy.save(tmp_path)
    assert seen_cameras(tmp_path) == {"front": 64, "wrist": 64}
    loaded = Tdmpc2Policy.load(tmp_path)
    assert (loaded.n_obs_steps, loaded.sizes) == (3, CAMERAS)
    np.testing.assert_array_equal(loaded.act(seen, generators(2)), actions)
    with pytest.raises(PolicyError, match=r"no 'observation.images.front'"):
        policy.act(observation(1))


def test_of_a_state_it_sees_no_camera(tmp_path):
    make().save(tmp_path)
    assert seen_cameras(tmp_path) == {}


def test_a_flipped_byte_in_the_weights_is_refused(tmp_path):
    make().save(tmp_path)
    path = tmp_path / "model.safetensors"
    content = bytearray(path.read_bytes())
    content[-1] ^= 1
    path.write_bytes(content)
    with pytest.raises(PolicyError, match="damaged, or was changed after it was saved"):
        Tdmpc2Policy.load(tmp_path)


def test_damaged_checkpoints_are_errors(tmp_path):
    make().save(tmp_path)
    path = tmp_path / "config.json"
    content = json.loads(path.read_text())
    for change, message in (
        ({"type": "act"}, "is of policy 'act', not of 'tdmpc2'"),
        ({"config": {"no_such_key": 1}}, "is not a configuration of policy 'tdmpc2'.*no_such_key"),
        ({"action_size": 3}, "does not fit the configuration beside it"),
    ):
        path.write_text(json.dumps(content | change))
        with pytest.raises(PolicyError, match=message):
            Tdmpc2Policy.load(tmp_path)
