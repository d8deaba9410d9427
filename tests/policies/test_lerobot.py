"""Our checkpoints in LeRobot's own code, and what the wrappers add to LeRobot's policies."""

import json

import numpy as np
import pytest
import torch
from lerobot.configs import PreTrainedConfig
from lerobot.policies.factory import get_policy_class, make_pre_post_processors
from torchvision.ops.misc import FrozenBatchNorm2d

import policies
from envs.core.errors import PolicyError
from tests.policies.examples import (
    CONFIGS,
    FEATURES,
    IMAGE,
    LEARNED,
    SIZE,
    generators,
    make,
    observation,
    stats,
)


def lerobot_chunk(folder, seen, seed=0):
    """What lerobot-eval computes: images to float CHW, preprocessor, policy, postprocessor."""
    config = PreTrainedConfig.from_pretrained(folder)
    policy = get_policy_class(config.type).from_pretrained(folder, config=config)
    pre, post = make_pre_post_processors(config, pretrained_path=folder)
    batch = {
        key: value.tolist() if value.dtype.kind == "U" else torch.from_numpy(value)
        for key, value in seen.items()
    }
    batch[IMAGE] = batch[IMAGE].movedim(-1, -3).contiguous().float() / 255
    torch.manual_seed(seed)
    with torch.inference_mode():
        return post(policy.predict_action_chunk(pre(batch))[:, : config.n_action_steps]).numpy()


@pytest.mark.slow
def test_lerobot_acts_the_same_from_our_act_checkpoint(tmp_path):
    policy = make("act")
    _train_a_little(policy)
    policy.save(tmp_path / "act")
    loaded = policies.load(tmp_path / "act")
    seen = observation(policy, 1)
    expected = lerobot_chunk(tmp_path / "act", seen)
    np.testing.assert_allclose(policy.act(seen), expected, atol=1e-5)
    np.testing.assert_allclose(loaded.act(seen), expected, rtol=1e-4, atol=1e-6)  # rounded otherwise


@pytest.mark.slow
def test_act_acts_with_the_weights_that_it_has_now():
    policy, other = make("act"), make("act")
    seen = observation(policy, 1)
    before = policy.act(seen)
    with torch.no_grad():
        other.model.model.backbone.conv1.weight *= -1.0
    policy.model.load_state_dict(other.model.state_dict())
    np.testing.assert_array_equal(policy.act(seen), other.act(seen))
    assert not np.allclose(policy.act(seen), before)


@pytest.mark.slow
def test_act_acts_with_the_weights_that_training_left():
    policy = make("act")
    seen = observation(policy, 1)
    acted = [policy.act(seen)]
    policy.begin_training()
    for _ in range(2):
        with torch.no_grad():
            policy.model.model.action_head.bias += 1.0
            policy.model.model.backbone.conv1.weight *= -1.0
        acted.append(policy.act(seen))
        assert policy.model.training
    policy.end_training()
    acted.append(policy.act(seen))
    assert not np.allclose(acted[0] + 0.3, acted[1], atol=1e-4)  # the convolution's weights count as well
    np.testing.assert_allclose(acted[2], acted[0] + 0.6, atol=1e-4)  # 0.3 is how actions are scaled
    np.testing.assert_allclose(acted[3], acted[2], atol=1e-5)


def test_lerobot_acts_the_same_from_our_diffusion_checkpoint(tmp_path):
    policy = make("diffusion")
    policy.save(tmp_path / "diffusion")
    seen = observation(policy, 1)
    expected = lerobot_chunk(tmp_path / "diffusion", seen, seed=5)
    torch.manual_seed(5)
    np.testing.assert_array_equal(policy.act(seen), expected)


def test_our_noise_is_lerobots_noise():
    policy = make("diffusion")
    seen = observation(policy, 1)
    torch.manual_seed(5)
    expected = policy.act(seen)
    np.testing.assert_array_equal(policy.act(seen, [torch.Generator().manual_seed(5)]), expected)


@pytest.mark.parametrize("scheduler", ["DDPM", "DDIM"])
def test_diffusion_noise_is_each_environments_own(scheduler):
    policy = make("diffusion", noise_scheduler_type=scheduler, num_inference_steps=4)
    seen = observation(policy, 3)
    alone = policy.act(seen, generators(3))
    policy.batch_invariant = False
    np.testing.assert_allclose(policy.act(seen, generators(3)), alone, atol=1e-4)
    assert not np.allclose(alone[0], policy.act(seen, generators(3, seed=1))[0])


def test_diffusion_with_one_observation():
    policy = make("diffusion", n_obs_steps=1)
    assert policy.delta_indices["observation.state"] == [0]
    assert policy.act(observation(policy, 2), generators(2)).shape == (2, 4, 9)
    assert policy.act(observation(policy, 2)).shape == (2, 4, 9)


def test_generators_must_be_one_per_environment():
    policy = make("diffusion")
    with pytest.raises(PolicyError, match="one generator per environment: 2, given 1"):
        policy.act(observation(policy, 2), generators(1))


def test_an_image_of_another_size_is_an_error():
    policy = make("act")
    seen = observation(policy, 1)
    seen[IMAGE] = np.zeros((1, 64, 64, 3), np.uint8)
    with pytest.raises(PolicyError, match=rf"shape \(1, 64, 64, 3\), but .* \(n, {SIZE}, {SIZE}, 3\)"):
        policy.act(seen)


def test_delta_indices():
    assert make("act").delta_indices == {"action": [0, 1, 2, 3, 4, 5]}
    deltas = make("diffusion").delta_indices
    assert deltas["action"] == [-1, 0, 1, 2, 3, 4, 5, 6]
    assert deltas[IMAGE] == deltas["observation.state"] == [-1, 0]


def test_diffusion_leaves_out_the_last_frames_of_an_episode_unless_told():
    assert make("diffusion").drop_last_frames == 8 - 4 - 2 + 1
    assert make("diffusion", drop_n_last_frames=0).drop_last_frames == 0
    assert make("diffusion", n_action_steps=7).drop_last_frames == 0


def test_bytes_and_floats_are_normalized_alike():
    policy = make("act")
    images = torch.randint(0, 256, (2, 3, SIZE, SIZE), dtype=torch.uint8)
    state = torch.rand(2, 9)
    bytes_ = policy.preprocess({IMAGE: images, "observation.state": state})
    floats = policy.preprocess({IMAGE: images.float() / 255, "observation.state": state})
    assert bytes_[IMAGE].equal(floats[IMAGE])
    torch.testing.assert_close(bytes_[IMAGE], (images.float() / 255 - 0.4) / 0.2)


@pytest.mark.parametrize(("image_stats", "mean", "std"), [("half", 0.5, 0.5), ("imagenet", 0.485, 0.229)])
def test_images_can_be_normalized_by_fixed_numbers(image_stats, mean, std):
    batch = make("act", image_stats=image_stats).preprocess({IMAGE: torch.ones(1, 3, SIZE, SIZE)})
    assert batch[IMAGE][0, 0, 0, 0].item() == pytest.approx((1 - mean) / std)


def test_a_joint_that_never_moved_is_not_amplified():
    own = stats()
    still = {"mean": np.ones(9), "std": np.zeros(9), "min": np.ones(9), "max": np.ones(9)}
    for name in LEARNED:
        policy = policies.create(name, FEATURES, own | {"action": still}, CONFIGS[name])
        batch = policy.preprocess(
            {"action": torch.full((1, 2, 9), 1.001), "observation.state": torch.ones(1, 9)}
        )
        assert batch["action"].abs().max() < 0.11
        assert policy.postprocessor(batch["action"]).numpy() == pytest.approx(1.001)


@pytest.mark.slow
def test_the_backbone_trains_with_batch_norm_and_is_saved_frozen():
    policy = make("act")
    names = set(policy.state_dict())
    policy.begin_training()
    assert not any(isinstance(module, FrozenBatchNorm2d) for module in policy.model.modules())
    assert set(policy.state_dict()) == names
    _train_a_little(policy)
    variance = policy.state_dict()["model.backbone.bn1.running_var"].clone()
    seen = observation(policy, 2)
    before = policy.act(seen)
    policy.end_training()
    assert not any(isinstance(module, torch.nn.BatchNorm2d) for module in policy.model.modules())
    assert policy.state_dict()["model.backbone.bn1.running_var"].equal(variance)
    assert not variance.equal(torch.ones_like(variance))
    np.testing.assert_allclose(policy.act(seen), before, atol=1e-5)


def test_pretrained_weights_keep_their_norm_frozen():
    policy = make("act", backbone_norm="frozen")
    policy.begin_training()
    assert any(isinstance(module, FrozenBatchNorm2d) for module in policy.model.modules())


def test_loading_never_downloads_backbone_weights(tmp_path):
    make("act").save(tmp_path / "act")
    path = tmp_path / "act" / "config.json"
    content = json.loads(path.read_text()) | {"pretrained_backbone_weights": "ResNet18_Weights.IMAGENET1K_V1"}
    path.write_text(json.dumps(content))
    assert policies.load(tmp_path / "act").model.config.pretrained_backbone_weights is None


def test_acting_leaves_training_mode_as_it_was():
    policy = make("act")
    policy.begin_training()
    policy.act(observation(policy, 1))
    assert policy.model.training


def _train_a_little(policy):
    policy.begin_training()
    rng = torch.Generator().manual_seed(0)
    batch = policy.preprocess(
        {
            IMAGE: torch.randint(0, 256, (4, 3, SIZE, SIZE), dtype=torch.uint8, generator=rng),
            "observation.state": torch.rand(4, 9, generator=rng),
            "action": torch.rand(4, 6, 9, generator=rng),
            "action_is_pad": torch.zeros(4, 6, dtype=torch.bool),
        }
    )
    optimizer = torch.optim.AdamW(policy.model.parameters(), lr=1e-3)
    for _ in range(3):
        loss, _terms = policy.model(dict(batch))
        loss.backward()
        optimizer.step()
        optimizer.zero_grad()
