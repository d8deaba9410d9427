"""Diffusion Policy over image keypoints."""

from dataclasses import replace

import numpy as np
import pytest
import torch

import policies
from envs.core.errors import PolicyError
from policies.checkpoint import policy_type
from policies.diffusion.config import DiffusionConfig
from policies.diffusion.modeling_keypoint_diffusion import KeypointDiffusionPolicy
from policies.keypoint_backbone import KeypointBackbone
from tests.policies.examples import FEATURES, IMAGE, SIZE, generators, observation, stats
from tests.policies.test_lerobot import lerobot_chunk

WRIST = "observation.images.wrist"
CONFIG = DiffusionConfig(
    vision_backbone="keypoints", n_obs_steps=2, horizon=8, n_action_steps=4, down_dims=(16, 32),
    num_train_timesteps=8, conv_channels=(8, 16), spatial_softmax_num_keypoints=4,
)  # fmt: skip


def make(config: DiffusionConfig = CONFIG, **more_cameras):
    features = FEATURES | {key: FEATURES[IMAGE] for key in more_cameras.values()}
    of_all = stats() | {key: stats()[IMAGE] for key in more_cameras.values()}
    return policies.create("diffusion", features, of_all, config)


def batch(size: int = 3) -> dict[str, torch.Tensor]:
    draw = torch.Generator().manual_seed(0)
    return {
        IMAGE: torch.randn(size, 2, 3, SIZE, SIZE, generator=draw),
        "observation.state": torch.randn(size, 2, 9, generator=draw),
        "action": torch.rand(size, 8, 9, generator=draw) * 2 - 1,
        "action_is_pad": torch.zeros(size, 8, dtype=torch.bool),
    }


def test_the_order_of_samples_and_observations_changes_nothing_of_each():
    network, samples = make(second=WRIST).model.diffusion, batch()
    samples["observation.images"] = torch.stack([samples[IMAGE], -samples[IMAGE]], 2)  # (B, T, cameras, …)
    with torch.no_grad():
        seen = network._prepare_global_conditioning(samples).unflatten(1, (2, -1))
        turned = {key: value[[2, 0, 1]].flip(1) for key, value in samples.items()}
        again = network._prepare_global_conditioning(turned).unflatten(1, (2, -1))
    assert seen.shape == (3, 2, 9 + 2 * 2 * 4)
    torch.testing.assert_close(again, seen[[2, 0, 1]].flip(1))
    assert not seen[0, 0].isclose(seen[0, 1]).all() and not seen[0].isclose(seen[1]).all()


def test_each_camera_has_convolutions_of_its_own_and_no_resnet():
    model = make(second=WRIST).model
    assert isinstance(model, KeypointDiffusionPolicy)
    backbones = [module for module in model.modules() if isinstance(module, KeypointBackbone)]
    assert len(backbones) == 2
    convolutions = (6 * 6 * 3 * 8 + 8) + (3 * 3 * 8 * 16 + 16)
    norms, heatmaps = 2 * 8 + 2 * 16, 16 * 4 + 4
    of_one = convolutions + norms + heatmaps
    assert sum(each.numel() for each in model.diffusion.rgb_encoder.parameters()) == 2 * of_one


@pytest.mark.parametrize("n_residual_blocks", [0, 1])
def test_lerobot_acts_the_same_from_a_checkpoint(n_residual_blocks, tmp_path):
    policy = make(replace(CONFIG, n_residual_blocks=n_residual_blocks))
    policy.save(tmp_path)
    seen = observation(policy, 1)
    expected = lerobot_chunk(tmp_path, seen, seed=5)
    torch.manual_seed(5)
    np.testing.assert_allclose(policy.act(seen), expected, atol=1e-5)
    loaded = policies.load(tmp_path)
    np.testing.assert_array_equal(loaded.act(seen, generators(1)), policy.act(seen, generators(1)))


def test_a_checkpoint_is_loaded_as_policy_diffusion(tmp_path):
    make().save(tmp_path)
    assert policy_type(tmp_path) == policies.load(tmp_path).name == "diffusion"


def test_noise_on_the_state_changes_the_loss_and_no_action():
    torch.manual_seed(0)
    plain = make()
    noisy = make(replace(CONFIG, state_noise=0.5))
    noisy.model.load_state_dict(plain.model.state_dict())
    losses = []
    for policy in (plain, noisy):
        torch.manual_seed(0)
        with torch.no_grad():
            losses.append(float(policy.loss(batch())[0]))
    assert losses[0] != losses[1]
    seen = observation(plain, 2)
    np.testing.assert_array_equal(noisy.act(seen, generators(2)), plain.act(seen, generators(2)))


def test_it_learns_where_a_spot_is():
    torch.manual_seed(0)
    policy = make(replace(CONFIG, prediction_type="sample"))
    policy.begin_training()
    optimizer = torch.optim.Adam(policy.model.parameters(), 3e-3)
    errors = []
    for _ in range(200):
        at = torch.randint(4, SIZE - 4, (16, 2))
        images = torch.zeros(16, 2, 3, SIZE, SIZE)
        for image, (row, column) in zip(images, at.tolist(), strict=True):
            image[..., row - 2 : row + 3, column - 2 : column + 3] = 3.0
        samples = batch(16) | {IMAGE: images, "observation.state": torch.zeros(16, 2, 9)}
        samples["action"] = torch.zeros(16, 8, 9)
        samples["action"][..., :2] = (at / SIZE * 2 - 1)[:, None]
        loss, _ = policy.loss(samples)
        loss.backward()
        optimizer.step()
        optimizer.zero_grad()
        errors.append(float(loss.detach()))
    guess = 2 / 9 * 0.75**2 / 3  # of one that does not look: the variance of two of nine actions
    assert np.mean(errors[-20:]) < 0.25 * guess


def test_autocast_computes_no_keypoint_in_bf16():
    policy, seen = make(), []
    network = policy.model.diffusion
    for module in (network.rgb_encoder[0].features[0], network.mixers[-1], network.unet):
        module.register_forward_hook(lambda _m, _i, out: seen.append(out.dtype))
    with torch.autocast("cpu", torch.bfloat16), torch.no_grad():
        policy.loss(batch())
    assert seen == [torch.bfloat16, torch.float32, torch.bfloat16]


@pytest.mark.parametrize(
    ("setting", "said"),
    [
        ({"conv_channels": (12,)}, r"policy\.conv_channels must be multiples of 8, given \(12,\)"),
        ({"conv_channels": ()}, r"policy\.conv_channels must be multiples of 8"),
        ({"spatial_softmax_num_keypoints": 0}, r"policy\.spatial_softmax_num_keypoints must be at least 1"),
        ({"n_residual_blocks": -1}, r"policy\.n_residual_blocks must be 0 or more, given -1"),
        ({"state_noise": -0.1}, r"policy\.state_noise must be 0 \(off\) or more"),
        ({"crop_ratio": 0.9}, r"crop_ratio=0\.9 is of a ResNet.*train\.augment\.shift_px=4"),
        ({"pretrained_backbone_weights": "X"}, r"pretrained_backbone_weights=X is of a ResNet"),
    ],
)
def test_a_wrong_setting_is_refused(setting, said):
    with pytest.raises(PolicyError, match=said):
        replace(CONFIG, **setting)
