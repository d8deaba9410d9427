"""The diffusion head: from a readout to a chunk of actions in a few denoising steps.

DDPM (arXiv:2006.11239) with the cosine schedule of arXiv:2102.09672; facts of the network are from the code
of its authors (github.com/octo-models/octo, components/diffusion.py and action_heads.py).

Shapes: B = batch, D = width of a readout, F = numbers of a chunk of actions.
"""

import math
from collections.abc import Sequence

import torch
from torch import Tensor, nn

from policies.octo.sizes import OctoSizes
from policies.octo.stem import EPS

_OFFSET = 0.008
"""``s`` of the cosine schedule."""


def cosine_betas(steps: int) -> Tensor:
    """Returns the variances that each step adds, (steps,), float64."""
    time = torch.linspace(0.0, 1.0, steps + 1, dtype=torch.float64)
    kept = torch.cos((time + _OFFSET) / (1.0 + _OFFSET) * math.pi / 2.0) ** 2
    return (1.0 - kept[1:] / kept[:-1]).clamp(0.0, 0.999)


class ResidualBlock(nn.Module):
    """A normalization and two linear layers, added to their input."""

    def __init__(self, width: int) -> None:
        super().__init__()
        self.norm = nn.LayerNorm(width, eps=EPS)
        self.fc1, self.fc2 = nn.Linear(width, 4 * width), nn.Linear(4 * width, width)

    def forward(self, features: Tensor) -> Tensor:
        """Returns features of the same shape."""
        return features + self.fc2(nn.functional.silu(self.fc1(self.norm(features))))


class DiffusionHead(nn.Module):
    """Denoises chunks of normalized actions.

    Args:
        sizes: Sizes of the network.
    """

    betas: Tensor
    kept: Tensor

    def __init__(self, sizes: OctoSizes) -> None:
        super().__init__()
        self.steps, self.max_action = sizes.diffusion_steps, sizes.max_action
        self.numbers, time, width = sizes.action_dim * sizes.chunk_size, sizes.time_size, sizes.head_width
        self.frequencies = nn.Parameter(torch.randn(time // 2, 1) * 0.2)
        self.time1, self.time2 = nn.Linear(time, 2 * time), nn.Linear(2 * time, time)
        self.first = nn.Linear(time + sizes.width + self.numbers, width)
        self.blocks = nn.ModuleList(ResidualBlock(width) for _ in range(sizes.head_blocks))
        self.last = nn.Linear(width, self.numbers)
        betas = cosine_betas(self.steps)
        self.register_buffer("betas", betas.float(), persistent=False)
        self.register_buffer("kept", (1.0 - betas).cumprod(0).float(), persistent=False)

    def forward(self, readout: Tensor, noisy: Tensor, time: Tensor) -> Tensor:
        """Returns the noise (B, F) in noisy actions.

        Args:
            readout: (B, D).
            noisy: (B, F).
            time: Diffusion step of each, (B, 1), from 0.
        """
        angles = 2.0 * math.pi * time.to(noisy.dtype) @ self.frequencies.T
        features = torch.cat([angles.cos(), angles.sin()], -1)
        features = self.time2(nn.functional.silu(self.time1(features)))
        hidden = self.first(torch.cat([features, readout, noisy], -1))
        for block in self.blocks:
            hidden = block(hidden)
        return self.last(nn.functional.silu(hidden))

    def errors(self, readout: Tensor, actions: Tensor, noise: Tensor, time: Tensor) -> Tensor:
        """Returns the squared errors (B, F) of the noise that is found in actions (B, F).

        Args:
            readout: (B, D).
            actions: Normalized, (B, F).
            noise: (B, F).
            time: (B, 1), int64.
        """
        kept = self.kept[time]
        clipped = actions.clamp(-self.max_action, self.max_action)
        noisy = kept.sqrt() * clipped + (1.0 - kept).sqrt() * noise
        return (self(readout, noisy, time) - noise) ** 2

    def sample(self, readout: Tensor, noise: Sequence[Tensor]) -> Tensor:
        """Returns normalized actions (B, F).

        Args:
            readout: (B, D).
            noise: ``1 + steps`` tensors (B, F): the start, and what each step adds; the last adds none.
        """
        actions = noise[0]
        for step, extra in zip(range(self.steps - 1, -1, -1), noise[1:], strict=True):
            beta, kept = self.betas[step], self.kept[step]
            time = torch.full((len(actions), 1), step, device=actions.device)
            found = self(readout, actions, time)
            actions = (actions - beta / (1.0 - kept).sqrt() * found) / (1.0 - beta).sqrt()
            if step:
                actions = actions + beta.sqrt() * extra
            actions = actions.clamp(-self.max_action, self.max_action)
        return actions
