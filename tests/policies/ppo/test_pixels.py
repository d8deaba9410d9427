"""PPO's policy that sees images and the robot's own state."""

import numpy as np
import pytest
import torch

import policies
from envs.core.errors import PolicyError
from policies.byte_rows import pack
from policies.checkpoint import seen_cameras
from policies.ppo.config import PpoConfig
from policies.ppo.network import LEAST_PIXELS, PixelEncoder
from policies.ppo.policy import PpoPolicy

SIZES = {"observation.images.front": 40, "observation.images.wrist": 40, "observation.state": 3}
NUM_FRAMES = 2


def make(num_frames: int = NUM_FRAMES) -> PpoPolicy:
    torch.manual_seed(0)
    config = PpoConfig(observation="pixels", num_frames=num_frames, hidden_dims=(8,))
    return PpoPolicy(config, SIZES, 2)


def observation(n: int, num_frames: int = NUM_FRAMES) -> dict[str, np.ndarray]:
    rng = np.random.default_rng(0)
    time = () if num_frames == 1 else (num_frames,)
    images = {key: rng.integers(0, 256, (n, *time, 40, 40, 3), np.uint8) for key in SIZES if "images" in key}
    return images | {"observation.state": rng.normal(size=(n, *time, 3)).astype(np.float32)}


@pytest.mark.parametrize("num_frames", [1, 2])
def test_what_it_sees_is_what_the_env_shows(num_frames: int) -> None:
    policy, given = make(num_frames), observation(2, num_frames)
    shown = []
    for frame in range(num_frames):
        now = (slice(None), frame) if num_frames > 1 else (slice(None),)
        cameras = [torch.from_numpy(given[key][now]) for key in SIZES if "images" in key]
        images = torch.cat(cameras, dim=-1).permute(0, 3, 1, 2)
        shown.append(pack(images, torch.from_numpy(given["observation.state"][now])))
    assert policy.seen(given).equal(torch.cat(shown, dim=1))


@pytest.mark.parametrize("num_frames", [1, 2])
def test_it_acts_and_is_loaded_with_its_cameras(num_frames: int, tmp_path) -> None:
    policy, seen = make(num_frames), observation(3, num_frames)
    policy.model.norm.update(policy.seen(seen))
    actions = policy.act(seen)
    assert actions.shape == (3, 1, 2) and (abs(actions) <= 1).all()
    policy.save(tmp_path)
    assert seen_cameras(tmp_path) == {"front": 40, "wrist": 40}
    loaded = policies.load(tmp_path)
    assert isinstance(loaded, PpoPolicy)
    assert (loaded.n_obs_steps, loaded.sizes, loaded.config) == (num_frames, SIZES, policy.config)
    np.testing.assert_array_equal(loaded.act(seen), actions)
    np.testing.assert_array_equal(actions[1:2], policy.act({key: value[1:2] for key, value in seen.items()}))


def test_actions_depend_on_every_part_of_an_observation() -> None:
    policy, seen = make(), observation(1)
    policy.model.norm.update(policy.seen(observation(50)))
    before = policy.act(seen)
    for key, value in seen.items():
        for frame in range(NUM_FRAMES):
            other = value.copy()
            other[:, frame] = 255 - other[:, frame] if value.dtype == np.uint8 else other[:, frame] + 1.0
            assert (policy.act(seen | {key: other}) != before).any(), (key, frame)


def test_observations_of_another_shape_are_errors() -> None:
    policy, seen = make(), observation(1)
    with pytest.raises(PolicyError, match=r"no 'observation.images.front', which policy 'ppo' needs"):
        policy.act({"observation.state": seen["observation.state"]})
    wrong = {"observation.state": np.zeros((1, NUM_FRAMES, 4), np.float32)}
    with pytest.raises(PolicyError, match=r"shape \(1, 2, 4\), but policy 'ppo' was made for \(n, 2, 3\)"):
        policy.act(seen | wrong)


def test_features_are_those_of_each_row_and_the_state_alone_is_normalized() -> None:
    encoder = PixelEncoder(1, LEAST_PIXELS, 2, 1)
    images = torch.randint(0, 256, (6, 3, LEAST_PIXELS, LEAST_PIXELS), dtype=torch.uint8)
    state = torch.randn(6, 2) * 5.0 + 3.0
    rows = pack(images, state)
    assert rows.shape[1] == encoder.size_in and rows.dtype == encoder.dtype_in
    encoder.update(rows)
    torch.testing.assert_close(encoder.norm.mean, state.mean(0))
    features = encoder(rows)
    assert features.shape == (6, encoder.size) == (6, 512)
    torch.testing.assert_close(features[:, 256:], encoder.state(encoder.norm(state)))
    torch.testing.assert_close(features[:, :256], encoder.images(images / 255.0 - 0.5))
    torch.testing.assert_close(encoder(rows.unflatten(0, (2, 3))), features.unflatten(0, (2, 3)))


def test_of_smaller_images_convolutions_leave_nothing() -> None:
    with pytest.warns(UserWarning, match="zero-element"):
        assert PixelEncoder(1, LEAST_PIXELS - 1, 1, 1).images[-2].in_features == 0
    assert PixelEncoder(1, LEAST_PIXELS, 1, 1).images[-2].in_features == 64


def test_stable_baselines3_keeps_no_images() -> None:
    with pytest.raises(PolicyError, match=r"backend=sb3 keeps rollouts on the host .*=rsl_rl or torchrl"):
        PpoConfig(backend="sb3", observation="pixels")
