"""The small ACT over image keypoints."""

from dataclasses import replace

import numpy as np
import pytest
import torch
from torch import nn

import policies
from envs.core.errors import PolicyError
from policies.act.config import ActConfig
from policies.keypoint_backbone import KeypointBackbone, ResidualBlock
from tests.policies.examples import FEATURES, IMAGE, SIZE, generators, observation, stats
from tests.policies.test_lerobot import lerobot_chunk

CONFIG = ActConfig(
    vision_backbone="keypoints", chunk_size=6, n_action_steps=4, dim_model=32, n_heads=2, dim_feedforward=64,
    n_encoder_layers=1, n_decoder_layers=2, conv_channels=(8, 16), n_keypoints=4, tokens_per_camera=2,
)  # fmt: skip


def make(config: ActConfig = CONFIG):
    return policies.create("act", FEATURES, stats(), config)


def batch(size: int = 3) -> dict[str, torch.Tensor]:
    draw = torch.Generator().manual_seed(0)
    pads = torch.zeros(size, 6, dtype=torch.bool)
    pads[0, 2:] = True
    return {
        IMAGE: torch.randn(size, 3, SIZE, SIZE, generator=draw),
        "observation.state": torch.randn(size, 9, generator=draw),
        "action": torch.randn(size, 6, 9, generator=draw),
        "action_is_pad": pads,
    }


def test_a_keypoint_is_where_its_heatmap_peaks():
    backbone = KeypointBackbone(2, (8,), 2)
    backbone.features, backbone.heatmaps = nn.Identity(), nn.Identity()
    maps = torch.zeros(1, 2, 5, 9)
    maps[0, 0, 1, 8] = maps[0, 1, 4, 2] = 100.0
    expected = [-0.5, 1.0, 1.0, -0.5]  # rows of both keypoints, then columns
    torch.testing.assert_close(backbone(maps)[0], torch.tensor(expected))


def test_a_residual_block_begins_as_what_it_sees_and_learns_to_change_it():
    block, maps = ResidualBlock(8), torch.rand(2, 8, 5, 4)
    torch.testing.assert_close(block(maps), maps)
    block(maps).square().mean().backward()
    gradient = block.layers[-1].weight.grad
    assert gradient is not None and gradient.abs().min() > 0


@pytest.mark.parametrize("n_residual_blocks", [0, 2])
def test_lerobot_acts_the_same_from_a_checkpoint(n_residual_blocks, tmp_path):
    policy = make(replace(CONFIG, n_residual_blocks=n_residual_blocks))
    for block in policy.model.model.backbones[0].features[6:]:
        nn.init.ones_(block.layers[-1].weight)  # as if it had learned something
    policy.save(tmp_path)
    seen = observation(policy, 1)
    np.testing.assert_allclose(policy.act(seen), lerobot_chunk(tmp_path, seen), atol=1e-5)
    np.testing.assert_array_equal(policies.load(tmp_path).act(seen), policy.act(seen))


def test_lerobots_commands_are_refused_with_the_images_that_are_missing():
    seen = batch()
    seen["observation.images.side"] = seen.pop(IMAGE)
    with pytest.raises(PolicyError) as refusal:
        make().model.select_action(seen)
    said = str(refusal.value)
    assert f"; missing: {IMAGE}; given: observation.images.side. Give what is missing" in said
    assert f'"{IMAGE}"' in said.split("--rename_map=")[1]
    del seen["observation.images.side"]
    with pytest.raises(PolicyError, match=r"; given: no image\."):
        make().model.select_action(seen)
    wrist = "observation.images.wrist"
    features, of_both = FEATURES | {wrist: FEATURES[IMAGE]}, stats() | {wrist: stats()[IMAGE]}
    both = policies.create("act", features, of_both, CONFIG).model
    with pytest.raises(PolicyError, match=rf"sees {IMAGE}, {wrist}; missing: {IMAGE}, {wrist}; given"):
        both.select_action(seen)


def test_a_checkpoint_is_loaded_as_policy_act(tmp_path):
    from policies.checkpoint import policy_type

    make().save(tmp_path)
    assert policy_type(tmp_path) == policies.load(tmp_path).name == "act"


@pytest.mark.parametrize("masked", [True, False])
def test_actions_after_the_end_count_unless_they_are_masked(masked):
    policy, samples = make(replace(CONFIG, mask_padding=masked)), batch()
    with torch.no_grad():
        loss, _ = policy.loss(samples)
        error = (policy.predict(samples, None) - samples["action"]).abs().mean(-1)
    counted = error[~samples["action_is_pad"]] if masked else error
    torch.testing.assert_close(loss, counted.mean(), rtol=1e-4, atol=1e-5)


def test_noise_on_the_state_changes_the_loss_and_no_action():
    noisy, plain = make(replace(CONFIG, state_noise=0.5)), make()
    samples, seen = batch(), observation(plain, 2)
    with torch.no_grad():
        assert noisy.loss(samples)[0] != plain.loss(samples)[0]
    np.testing.assert_array_equal(noisy.act(seen, generators(2)), plain.act(seen, generators(2)))


def test_it_learns_where_a_spot_is():
    torch.manual_seed(0)
    policy = make(replace(CONFIG, n_decoder_layers=1))
    policy.begin_training()
    optimizer = torch.optim.Adam(policy.model.parameters(), 3e-3)
    losses = []
    for _ in range(150):
        at = torch.randint(4, SIZE - 4, (16, 2))
        images = torch.zeros(16, 3, SIZE, SIZE)
        for image, (row, column) in zip(images, at.tolist(), strict=True):
            image[:, row - 2 : row + 3, column - 2 : column + 3] = 3.0
        samples = batch(16) | {IMAGE: images, "observation.state": torch.zeros(16, 9)}
        samples["action"] = torch.zeros(16, 6, 9)
        samples["action"][..., :2] = (at / SIZE * 4 - 2)[:, None]
        loss, _ = policy.loss(samples)
        loss.backward()
        optimizer.step()
        optimizer.zero_grad()
        losses.append(float(loss.detach()))
    guess = (
        2 / 9 * 0.75
    )  # of one that does not look: the mean distance from the middle, of two of nine actions
    assert np.mean(losses[-20:]) < 0.4 * guess


@pytest.mark.parametrize(
    ("setting", "said"),
    [
        ({"conv_channels": (12,)}, r"policy\.conv_channels=\[12\] must be multiples of 8"),
        ({"n_keypoints": 0}, r"policy\.n_keypoints must be at least 1, given 0"),
        ({"n_residual_blocks": -1}, r"policy\.n_residual_blocks must be 0 or more, given -1"),
        ({"state_noise": -0.1}, r"policy\.state_noise must be 0 \(off\) or more"),
    ],
)
def test_a_wrong_size_is_refused(setting, said):
    with pytest.raises(PolicyError, match=said):
        replace(CONFIG, **setting)


def test_autocast_computes_the_convolutions_alone_in_bf16():
    policy, samples = make(), batch()
    seen = {}
    network = policy.model.model
    handles = [
        module.register_forward_hook(lambda _, __, out, name=name: seen.__setitem__(name, out.dtype))
        for name, module in network.named_modules()
        if isinstance(module, nn.Conv2d | nn.Linear)
    ]
    with torch.no_grad(), torch.autocast("cpu", torch.bfloat16):
        policy.loss(samples)
    for handle in handles:
        handle.remove()
    kinds = {
        kind: {dtype for name, dtype in seen.items() if ("backbones" in name) == kind}
        for kind in (True, False)
    }
    assert kinds == {True: {torch.bfloat16}, False: {torch.float32}}
