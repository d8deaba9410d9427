"""Diffusion Policy over image keypoints: LeRobot's policy type ``keypoint_diffusion``.

Shape legend: B = samples, C, H, W = an image, K = keypoints.
"""

from typing import Any

import torch
from lerobot.policies.diffusion.modeling_diffusion import DiffusionPolicy as LeRobotDiffusionPolicy
from torch import Tensor, nn
from torch.nn import functional

from policies.diffusion.configuration_keypoint_diffusion import KeypointDiffusionConfig
from policies.keypoint_backbone import KeypointBackbone


class KeypointDiffusionPolicy(LeRobotDiffusionPolicy):
    """LeRobot's Diffusion Policy whose cameras have a small encoder each.

    Args:
        config: Its configuration.
    """

    config_class: Any = KeypointDiffusionConfig
    name: Any = "keypoint_diffusion"

    def __init__(self, config: KeypointDiffusionConfig, **kwargs: Any) -> None:
        config.use_separate_rgb_encoder_per_camera = True
        super().__init__(config, **kwargs)
        if config.image_features:
            self.diffusion.rgb_encoder = nn.ModuleList(
                KeypointEncoder(shape.shape[0], config) for shape in config.image_features.values()
            )


class KeypointEncoder(nn.Module):
    """The features of one camera's images.

    Args:
        in_channels: Channels of an image.
        config: Its sizes.
    """

    def __init__(self, in_channels: int, config: KeypointDiffusionConfig) -> None:
        super().__init__()
        n_keypoints = config.spatial_softmax_num_keypoints
        self.backbone = KeypointBackbone(
            in_channels, config.conv_channels, n_keypoints, config.n_residual_blocks
        )
        self.feature_dim = 2 * n_keypoints
        self.out = nn.Linear(self.feature_dim, self.feature_dim)

    def forward(self, images: Tensor) -> Tensor:
        """Returns features (B, 2 K) of images (B, C, H, W)."""
        keypoints = self.backbone(images)
        # In bf16, a coordinate would be off by up to 0.1 pixels of 96: only the convolutions compute in it.
        with torch.autocast(keypoints.device.type, enabled=False):
            return functional.relu(self.out(keypoints))
