"""The image stem: four convolutions and a linear layer of each patch (``SmallStem16``).

Facts of the network are from the authors' code (github.com/octo-models/octo, components/vit_encoders.py); the
idea is "Early convolutions help transformers see better", arXiv:2106.14881.
"""

from collections.abc import Sequence

import torch
from torch import Tensor, nn

GROUPS, EPS = 32, 1e-6
"""Flax's group normalization, and the least variance of its normalizations."""

_STANDARD_EPS = 1e-5


class StandardConv(nn.Conv2d):
    """A convolution of stride 2 whose weights have mean 0 and deviation 1 for each output channel."""

    def __init__(self, inputs: int, outputs: int) -> None:
        super().__init__(inputs, outputs, 3, stride=2, padding=1)

    def forward(self, input: Tensor) -> Tensor:
        """Returns features (B, outputs, S / 2, S / 2) of (B, inputs, S, S)."""
        centered = self.weight - self.weight.mean((1, 2, 3), keepdim=True)
        deviation = centered.std((1, 2, 3), keepdim=True, correction=0)
        weight = centered / (deviation + _STANDARD_EPS)
        return nn.functional.conv2d(input, weight, self.bias, self.stride, self.padding)


class Stem(nn.Module):
    """Patches of 16 pixels a side to vectors.

    Args:
        channels: Of the four convolutions, each a multiple of 32.
        outputs: Width of a patch's vector.
    """

    def __init__(self, channels: Sequence[int], outputs: int) -> None:
        super().__init__()
        before = (6, *channels[:-1])
        self.convolutions = nn.ModuleList(map(StandardConv, before, channels))
        self.norms = nn.ModuleList(nn.GroupNorm(GROUPS, each, eps=EPS) for each in channels)
        self.embedding = nn.Conv2d(channels[-1], outputs, 1)

    def forward(self, images: Tensor) -> Tensor:
        """Returns vectors (B, P, outputs) of images (B, 3, S, S) from -1 to 1, in rows from the upper left.

        The stem takes an image of the goal, too; without one it is black.
        """
        goal = torch.full_like(images, -1.0)
        features = torch.cat([images, goal], 1)
        for convolution, norm in zip(self.convolutions, self.norms, strict=True):
            features = torch.relu(norm(convolution(features)))
        return self.embedding(features).flatten(2).transpose(1, 2)
