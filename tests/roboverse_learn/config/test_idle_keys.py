"""Keys that have no effect beside the others are refused, also at their defaults."""

from contextlib import nullcontext

import pytest

from envs.core.errors import ConfigError
from roboverse_learn.config.compose import compose


def test_steps_of_sampling_need_a_head_that_samples():
    said = r"num_inference_steps alone has no effect: add policy\.head=flow, or leave it out"
    for words in (
        ["policy.num_inference_steps=5"],
        ["policy.head=regression", "policy.num_inference_steps=9"],
    ):
        with pytest.raises(ConfigError, match=said):
            compose("train", ["policy=mtact", *words])
    for policy in ("mtact", "diffusion"):
        words = ["policy.head=flow"] if policy == "mtact" else []
        config = compose("train", [f"policy={policy}", *words, "policy.num_inference_steps=5"])
        assert config.policy.num_inference_steps == 5


@pytest.mark.parametrize(
    ("encoder", "key", "needs"),
    [
        ("scratch", "sentence_noise=1", "<folder>"),
        (".", "word_dropout=0.1", "scratch"),
        (".", "max_words=9", "scratch"),
        (".", "text_layers=2", "scratch"),
        (".", "num_buckets=99", "scratch"),
    ],
)
def test_settings_of_one_text_encoder_are_refused_beside_the_other(encoder, key, needs):
    said = rf"{key.partition('=')[0]} alone has no effect: add policy\.text_encoder={needs}, or leave"
    with pytest.raises(ConfigError, match=said):
        compose("train", ["policy=mtact", f"text_encoder={encoder}", f"policy.{key}"])


@pytest.mark.parametrize("policy", ["act", "diffusion"])
def test_convolutions_of_keypoints_are_refused_beside_a_resnet(policy: str):
    for key in ("conv_channels=[16]", "n_residual_blocks=0"):
        said = rf"{key.partition('=')[0]} alone has no effect: add policy\.vision_backbone=keypoints, or"
        with pytest.raises(ConfigError, match=said):
            compose("train", [f"policy={policy}", f"policy.{key}"])
        compose("train", [f"policy={policy}", "policy.vision_backbone=keypoints", f"policy.{key}"])


def test_keys_of_a_recipe_count_as_typed(tmp_path):
    recipe = tmp_path / "deep.yaml"
    for backbone, refused in (("resnet18", True), ("keypoints", False)):
        recipe.write_text(
            f"policy_name: act\npolicy: {{vision_backbone: {backbone}, n_residual_blocks: 4}}\n"
        )
        with pytest.raises(ConfigError, match="n_residual_blocks alone") if refused else nullcontext():
            compose("train", [f"recipe={recipe}"])


@pytest.mark.parametrize("policy", ["lerobot", "octo"])
def test_settings_of_adapters_need_a_method(policy: str):
    words = [f"policy={policy}", "policy.path=base", "peft.r=16"]
    with pytest.raises(ConfigError, match=r"peft\.r alone has no effect: add peft\.method_type=LORA, or"):
        compose("train", words)
    assert compose("train", [*words, "peft.method_type=LORA"]).policy.peft.r == 16
