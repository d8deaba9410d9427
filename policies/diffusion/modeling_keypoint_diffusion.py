"""Diffusion Policy over image keypoints: LeRobot's policy type ``keypoint_diffusion``.

LeRobot's encoder of a camera is a ResNet and a layer after it, and its U-Net reads what the cameras and the
joints say by one linear layer a block. Here keypoints and joints are mixed by a few layers first: what a hand
has to do depends on several of them at once.

Shape legend: B = samples, T = observations, C, H, W = an image, K = keypoints, D = joints and keypoints of
all cameras.
"""

from typing import Any

import torch
from lerobot.policies.diffusion.modeling_diffusion import (
    DiffusionConditionalUnet1d,
    DiffusionModel,
    _make_noise_scheduler,
)
from lerobot.policies.diffusion.modeling_diffusion import DiffusionPolicy as LeRobotDiffusionPolicy
from lerobot.policies.pretrained import PreTrainedPolicy
from lerobot.utils.constants import OBS_ENV_STATE, OBS_IMAGES, OBS_STATE
from torch import Tensor, nn

from policies.diffusion.configuration_keypoint_diffusion import KeypointDiffusionConfig
from policies.keypoint_backbone import KeypointBackbone

_NUM_MIXERS = 2
_MIXER_WIDTH = 512


class KeypointDiffusionPolicy(LeRobotDiffusionPolicy):
    """LeRobot's Diffusion Policy over keypoints.

    Args:
        config: Its configuration.
    """

    config_class: Any = KeypointDiffusionConfig
    name: Any = "keypoint_diffusion"

    def __init__(self, config: KeypointDiffusionConfig, **_: Any) -> None:
        PreTrainedPolicy.__init__(self, config)  # LeRobot's own would make ResNets first
        config.validate_features()
        self.config: Any = config
        self.diffusion: Any = KeypointDiffusion(config)
        self.reset()


class KeypointDiffusion(DiffusionModel):
    """The network.

    Args:
        config: Its sizes, a :class:`KeypointDiffusionConfig`.
    """

    def __init__(self, config: Any) -> None:
        nn.Module.__init__(self)  # likewise
        self.config = config
        n_keypoints, size = config.spatial_softmax_num_keypoints, config.robot_state_feature.shape[0]
        if config.env_state_feature:
            size += config.env_state_feature.shape[0]
        if config.image_features:
            size += 2 * n_keypoints * len(config.image_features)
            self.rgb_encoder = nn.ModuleList(
                KeypointBackbone(shape.shape[0], config.conv_channels, n_keypoints, config.n_residual_blocks)
                for shape in config.image_features.values()
            )
        self.mixers = nn.ModuleList(Mixer(size, _MIXER_WIDTH) for _ in range(_NUM_MIXERS))
        self.unet = DiffusionConditionalUnet1d(config, global_cond_dim=size * config.n_obs_steps)
        self.noise_scheduler = _make_noise_scheduler(
            config.noise_scheduler_type,
            num_train_timesteps=config.num_train_timesteps,
            beta_start=config.beta_start,
            beta_end=config.beta_end,
            beta_schedule=config.beta_schedule,
            clip_sample=config.clip_sample,
            clip_sample_range=config.clip_sample_range,
            prediction_type=config.prediction_type,
        )
        self.num_inference_steps = config.num_inference_steps or config.num_train_timesteps

    def _prepare_global_conditioning(self, batch: dict[str, Tensor]) -> Tensor:
        """Returns what the U-Net is conditioned on, (B, T D)."""
        seen = [batch[OBS_STATE]]  # (B, T, joints)
        if self.config.image_features:
            images = batch[OBS_IMAGES]  # (B, T, cameras, C, H, W)
            seen += [
                encoder(images[:, :, camera].flatten(0, 1)).unflatten(0, images.shape[:2])
                for camera, encoder in enumerate(self.rgb_encoder)
            ]
        if self.config.env_state_feature:
            seen.append(batch[OBS_ENV_STATE])
        # In bf16, a coordinate would be off by up to 0.1 pixels of 96: only the convolutions compute in it.
        with torch.autocast(seen[0].device.type, enabled=False):
            mixed = torch.cat([each.float() for each in seen], -1)
            for mixer in self.mixers:
                mixed = mixer(mixed)
        return mixed.flatten(1)


class Mixer(nn.Module):
    """A layer of features (..., D) whose result is added to what it sees.

    Args:
        size: D.
        width: Width between its two linear layers.
    """

    def __init__(self, size: int, width: int) -> None:
        super().__init__()
        self.layers = nn.Sequential(
            nn.LayerNorm(size), nn.Linear(size, width), nn.ReLU(inplace=True), nn.Linear(width, size)
        )

    def forward(self, features: Tensor) -> Tensor:
        """Returns features of the same shape."""
        return features + self.layers(features)
