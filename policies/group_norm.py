"""Group normalization of images that keeps channels last."""

from typing import Self

import torch
from torch import Tensor, nn


class ChannelsLastGroupNorm(nn.GroupNorm):
    """Group normalization that reads and writes images with channels last where it is compiled.

    PyTorch's own gives its answer with channels first, in fp32, so that every convolution of a network in
    bf16 is preceded and followed by a copy of its images. Statistics are computed in fp32 here too.
    In eager code it is PyTorch's.
    """

    @classmethod
    def of(cls, norm: nn.GroupNorm) -> Self:
        """Returns the normalization by the same parameters."""
        new = cls(norm.num_groups, norm.num_channels, norm.eps, device="meta")
        new.weight, new.bias = norm.weight, norm.bias
        return new

    def forward(self, input: Tensor) -> Tensor:
        """Normalizes images (B, C, H, W)."""
        if not torch.compiler.is_compiling():
            return super().forward(input)
        grouped = input.permute(0, 2, 3, 1).unflatten(-1, (self.num_groups, -1)).float()
        variance, mean = torch.var_mean(grouped, dim=(1, 2, 4), correction=0, keepdim=True)
        normalized = ((grouped - mean) * torch.rsqrt(variance + self.eps)).flatten(-2)
        return (normalized * self.weight + self.bias).to(input.dtype).permute(0, 3, 1, 2)
