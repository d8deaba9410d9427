"""Networks of one camera whose channels the instruction scales and shifts (FiLM, arXiv:1709.07871).

Tokens of a sentence beside those of images are easily ignored where images differ little; here no image is
seen without the sentence.

Shape legend: B = samples, C, H, W = an image, K = keypoints, D = width of the sentence vector.
"""

from typing import Any

import torchvision
from torch import Tensor, nn

from policies.keypoint_backbone import KeypointBackbone, spatial_softmax

_GROUP_CHANNELS = 16
_NUM_STAGES = 3
"""Stages of a ResNet that are used: the fourth would leave 4 × 4 cells of 128 pixels, few for keypoints."""


class Film(nn.Module):
    """Scales and shifts the channels of images by a sentence vector; at first it changes nothing.

    Args:
        dim: Width of the sentence vector.
        channels: Channels of the images.
    """

    def __init__(self, dim: int, channels: int) -> None:
        super().__init__()
        self.linear = nn.Linear(dim, 2 * channels)
        nn.init.zeros_(self.linear.weight)
        nn.init.zeros_(self.linear.bias)

    def forward(self, images: Tensor, sentence: Tensor) -> Tensor:
        """Returns images (B, C, H, W) changed by vectors (B, D)."""
        scale, shift = self.linear(sentence)[..., None, None].chunk(2, 1)
        return images * (1.0 + scale) + shift


class FilmKeypointBackbone(nn.Module):
    """The convolutions of the keypoint ACT, with FiLM after each normalization.

    Args:
        in_channels: Channels of an image.
        channels: Channels of each convolution.
        n_keypoints: Keypoints.
        dim: Width of the sentence vector.
    """

    def __init__(self, in_channels: int, channels: tuple[int, ...], n_keypoints: int, dim: int) -> None:
        super().__init__()
        plain = KeypointBackbone(in_channels, channels, n_keypoints)
        self.features, self.heatmaps = plain.features, plain.heatmaps
        self.films = nn.ModuleList(Film(dim, width) for width in channels)

    def forward(self, images: Tensor, sentence: Tensor) -> Tensor:
        """Returns the keypoints (B, 2 K) of images (B, C, H, W), by sentence vectors (B, D)."""
        layers = list(self.features)
        for index, film in enumerate(self.films):
            convolution, norm, activation = layers[3 * index : 3 * index + 3]
            images = activation(film(norm(convolution(images)), sentence))
        return spatial_softmax(self.heatmaps(images))


class FilmResNet(nn.Module):
    """Three stages of a ResNet with group normalization, with FiLM after each stage.

    Args:
        name: One of torchvision's ResNets.
        in_channels: Channels of an image.
        n_keypoints: Keypoints.
        dim: Width of the sentence vector.
    """

    def __init__(self, name: str, in_channels: int, n_keypoints: int, dim: int) -> None:
        super().__init__()
        network: Any = getattr(torchvision.models, name)(weights=None, norm_layer=_group_norm)
        if in_channels != network.conv1.in_channels:
            network.conv1 = nn.Conv2d(in_channels, network.conv1.out_channels, 7, 2, 3, bias=False)
        self.stem = nn.Sequential(network.conv1, network.bn1, network.relu, network.maxpool)
        stages = [network.layer1, network.layer2, network.layer3][:_NUM_STAGES]
        widths = [stage[-1].conv2.out_channels for stage in stages]
        self.stages = nn.ModuleList(stages)
        self.films = nn.ModuleList(Film(dim, width) for width in widths)
        self.heatmaps = nn.Conv2d(widths[-1], n_keypoints, 1)

    def forward(self, images: Tensor, sentence: Tensor) -> Tensor:
        """Returns the keypoints (B, 2 K) of images (B, C, H, W), by sentence vectors (B, D)."""
        images = self.stem(images)
        for stage, film in zip(self.stages, self.films, strict=True):
            images = film(stage(images), sentence)
        return spatial_softmax(self.heatmaps(images))


def _group_norm(channels: int) -> nn.GroupNorm:
    return nn.GroupNorm(max(1, channels // _GROUP_CHANNELS), channels)
