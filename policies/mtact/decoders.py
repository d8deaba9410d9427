"""Decoders of action chunks: by regression, and by flow matching.

Shape legend: B = samples, S = tokens of the observation, D = width, T = actions of a chunk, A = entries of an
action.
"""

import math

import torch
from torch import Tensor, nn

from policies.act.modeling_keypoint_act import DecoderBlock

_TIME_POWER = 1.5
"""Times are 1 − u^(1 / 1.5): Beta(1, 1.5), which samples noisy actions more often (π0, arXiv:2410.24164,
appendix B)."""

_MAX_PERIOD = 4.0
_MIN_PERIOD = 4e-3
"""Periods of the sines of time, from 0 to 1 (π0's code: 4 and 4e-3)."""


class RegressionDecoder(nn.Module):
    """One query per future action, with the L1 error.

    Args:
        chunk_size: T.
        action_size: A.
        dim: Width.
        heads: Attention heads.
        feedforward: Width of the feed-forward layers.
        layers: Layers.
    """

    term = "l1_loss"

    def __init__(
        self, chunk_size: int, action_size: int, dim: int, heads: int, feedforward: int, layers: int
    ) -> None:
        super().__init__()
        self.queries = nn.Parameter(0.5 * torch.randn(chunk_size, dim))
        self.blocks = nn.ModuleList(
            DecoderBlock(dim, heads, feedforward, attends_to_itself=index > 0) for index in range(layers)
        )
        self.norm = nn.LayerNorm(dim)
        self.action_head = nn.Linear(dim, action_size)

    def forward(self, memory: Tensor, noise: Tensor | None = None, is_own: Tensor | None = None) -> Tensor:
        """Returns normalized actions (B, T, A) of a memory (B, S, D); draws nothing."""
        del noise, is_own
        tokens = self.queries.expand(len(memory), -1, -1)
        for block in self.blocks:
            tokens = block(tokens, memory)
        return self.action_head(self.norm(tokens))

    def errors(self, memory: Tensor, actions: Tensor, is_own: Tensor) -> Tensor:
        """Returns the distance of each entry of the actions (B, T, A); see :class:`FlowDecoder`."""
        del is_own
        return (self(memory) - actions).abs()


class FlowDecoder(nn.Module):
    """A velocity that carries noise to actions on straight lines (flow matching, arXiv:2210.02747).

    Args:
        chunk_size: T.
        action_size: A.
        dim: Width.
        heads: Attention heads.
        feedforward: Width of the feed-forward layers.
        layers: Layers.
        num_steps: Euler steps from noise to actions.
    """

    term = "flow_loss"

    def __init__(
        self,
        chunk_size: int,
        action_size: int,
        dim: int,
        heads: int,
        feedforward: int,
        layers: int,
        num_steps: int,
    ) -> None:
        super().__init__()
        self.chunk_size, self.action_size, self.num_steps = chunk_size, action_size, num_steps
        self.action_in = nn.Linear(action_size, dim)
        self.positions = nn.Parameter(0.1 * torch.randn(chunk_size, dim))
        self.time = nn.Sequential(nn.Linear(dim, dim), nn.SiLU(), nn.Linear(dim, dim))
        self.blocks = nn.ModuleList(
            DecoderBlock(dim, heads, feedforward, attends_to_itself=True) for _ in range(layers)
        )
        self.norm = nn.LayerNorm(dim)
        self.action_head = nn.Linear(dim, action_size)

    def forward(self, memory: Tensor, noise: Tensor | None = None, is_own: Tensor | None = None) -> Tensor:
        """Returns normalized actions (B, T, A).

        Args:
            memory: (B, S, D).
            noise: (B, T, A), normal; None draws it from torch's global generator.
            is_own: (B, A), false where an entry is padding, which stays 0; None where none is.
        """
        if noise is None:
            noise = torch.randn(len(memory), self.chunk_size, self.action_size, device=memory.device)
        own = 1.0 if is_own is None else is_own[:, None].float()
        actions = noise * own
        for step in range(self.num_steps):
            time = memory.new_full((len(memory),), step / self.num_steps)
            actions = (actions + self.velocity(actions, time, memory) / self.num_steps) * own
        return actions

    def errors(self, memory: Tensor, actions: Tensor, is_own: Tensor) -> Tensor:
        """Returns the squared error of each entry of the velocity at a random time.

        Args:
            memory: (B, S, D).
            actions: (B, T, A), normalized.
            is_own: (B, A), false where an entry is padding: neither noise nor action is seen there.
        """
        noise = torch.randn_like(actions)
        uniform = torch.rand(len(actions), device=actions.device)
        time = 1.0 - uniform.pow(1.0 / _TIME_POWER)
        mixed = torch.lerp(noise, actions, time[:, None, None]) * is_own[:, None]
        return (self.velocity(mixed, time, memory).float() - (actions - noise)).square()

    def velocity(self, actions: Tensor, time: Tensor, memory: Tensor) -> Tensor:
        """Returns the velocity (B, T, A) of actions at times (B,): 0 is noise, 1 the actions."""
        embedded = self.time(sines(time, self.positions.shape[1]))
        tokens = self.action_in(actions) + self.positions + embedded[:, None]
        for block in self.blocks:
            tokens = block(tokens, memory)
        return self.action_head(self.norm(tokens))


def sines(time: Tensor, dim: int) -> Tensor:
    """Returns sines and cosines (B, dim) of times (B,) from 0 to 1."""
    spread = torch.linspace(0.0, 1.0, dim // 2, device=time.device)
    angles = time[:, None] * (2.0 * math.pi / _MIN_PERIOD) * (_MIN_PERIOD / _MAX_PERIOD) ** spread
    return torch.cat([angles.sin(), angles.cos()], 1)
