import subprocess
import sys

import pytest

import policies
from envs.core.errors import PolicyError, UnknownNameError
from policies.act.config import ActConfig
from tests.policies.examples import CONFIGS, FEATURES, stats


def test_names():
    assert policies.names() == [
        "act",
        "diffusion",
        "fasttd3",
        "lerobot",
        "mtact",
        "octo",
        "openvla",
        "ppo",
        "tdmpc2",
    ]
    assert policies.names("nothing") == ["hold", "random", "zero"]


def test_an_unknown_policy_is_named_with_the_nearest():
    with pytest.raises(
        UnknownNameError, match=r"Unknown policy 'difusion'. Did you mean 'diffusion'\? Valid: act, diff"
    ):
        policies.config_class("difusion")


def test_policies_that_read_instructions_are_known():
    assert policies.learns_several("mtact") and policies.learns_several("octo")
    assert not policies.learns_several("act") and not policies.learns_several("diffusion")


def test_listing_imports_nothing_heavy():
    code = (
        "import sys, policies; [policies.config_class(n)() for n in policies.names()];"
        "sys.exit(any(m in sys.modules for m in ('torch', 'lerobot')))"
    )
    assert subprocess.run([sys.executable, "-c", code], check=False).returncode == 0


def test_a_config_of_another_policy_is_an_error():
    with pytest.raises(PolicyError, match="'act' takes a ActConfig, given a DiffusionConfig"):
        policies.create("act", FEATURES, stats(), CONFIGS["diffusion"])


def test_first_weights_depend_on_the_seed_alone():
    def first(seed):
        policy = policies.create("act", FEATURES, stats(), CONFIGS["act"], seed=seed)
        return policy.state_dict()["model.action_head.weight"]

    assert first(1).equal(first(1))
    assert not first(1).equal(first(2))


@pytest.mark.parametrize(
    ("removed", "message"),
    [
        (["observation.images.front"], "neither an image"),
        (["action"], "has no 'action'. It has: observation.images.front"),
        (["observation.state"], "has no 'observation.state'"),
    ],
)
def test_a_dataset_that_lacks_a_feature_is_an_error(removed, message):
    features = {key: value for key, value in FEATURES.items() if key not in removed}
    with pytest.raises(PolicyError, match=message):
        policies.create("act", features, stats(), CONFIGS["act"])


def test_a_dataset_that_lacks_statistics_is_an_error():
    with pytest.raises(PolicyError, match="has no mean, std, min, max of 'action' in its statistics"):
        policies.create("act", FEATURES, stats() | {"action": {}}, CONFIGS["act"])


@pytest.mark.parametrize(
    ("changes", "message"),
    [
        ({"n_action_steps": 101}, r"policy.n_action_steps=101 must be from 1 to policy.chunk_size=100"),
        ({"dim_model": 30}, "policy.dim_model=30 must be a multiple of 4 and of policy.n_heads=8"),
        ({"dropout": 1.0}, "policy.dropout must be from 0 to below 1, given 1.0"),
    ],
)
def test_act_config_is_checked(changes, message):
    with pytest.raises(PolicyError, match=message):
        ActConfig(**changes)


@pytest.mark.parametrize(
    ("changes", "message"),
    [
        ({"horizon": 10}, r"policy.horizon=10 must be a multiple of 8.*take 8"),
        ({"n_action_steps": 7}, "policy.n_action_steps=7 must be from 1 to 6"),
        ({"n_obs_steps": 0}, "policy.n_obs_steps must be at least 1, given 0"),
        ({"down_dims": (100, 200, 300)}, "policy.down_dims must be multiples of 8"),
        ({"num_inference_steps": 200}, "policy.num_inference_steps=200 must be from 1 to"),
        ({"crop_ratio": 0.0}, "policy.crop_ratio must be above 0"),
    ],
)
def test_diffusion_config_is_checked(changes, message):
    with pytest.raises(PolicyError, match=message):
        policies.config_class("diffusion")(**changes)


@pytest.mark.slow
@pytest.mark.parametrize(("name", "millions"), [("act", 51.6), ("diffusion", 77.3)])
def test_full_size_parameters(name, millions):
    """ACT with one camera, and Diffusion Policy with about the 78 million of RoboVerse's paper."""
    import torch

    from policies.lerobot_policy import policy_features

    with torch.device("meta"):
        cls = policies.policy_class(name)
        inputs, outputs = policy_features(FEATURES)
        policy = cls.make_model(cls.lerobot_config(policies.config_class(name)(), inputs, outputs, "cpu"))
    count = sum(parameter.numel() for parameter in policy.parameters()) / 1e6
    assert count == pytest.approx(millions, abs=0.1)
