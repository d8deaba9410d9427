"""The transformer over groups of tokens, and which tokens look at which.

Facts are from the authors' code (github.com/octo-models/octo, components/transformer.py and
block_transformer.py).

Shapes: B = batch, T = observations in time, L = tokens of all of them, D = width.
"""

from collections.abc import Sequence
from typing import Literal

import numpy as np
import torch
from torch import Tensor, nn

from policies.octo.stem import EPS

Kind = Literal["task", "observation", "readout"]


class Block(nn.Module):
    """Attention and a feed-forward part, each after a normalization."""

    def __init__(self, width: int, heads: int, mlp: int) -> None:
        super().__init__()
        self.heads = heads
        self.norm1, self.norm2 = nn.LayerNorm(width, eps=EPS), nn.LayerNorm(width, eps=EPS)
        self.query, self.key, self.value, self.out = (nn.Linear(width, width) for _ in range(4))
        self.fc1, self.fc2 = nn.Linear(width, mlp), nn.Linear(mlp, width)

    def forward(self, tokens: Tensor, mask: Tensor) -> Tensor:
        """Returns tokens (B, L, D).

        Args:
            tokens: Tokens (B, L, D).
            mask: Whether a token (row) looks at another (column), (B, 1, L, L).
        """
        normed = self.norm1(tokens)
        parts = [
            layer(normed).unflatten(-1, (self.heads, -1)).transpose(1, 2)
            for layer in (self.query, self.key, self.value)
        ]
        seen = nn.functional.scaled_dot_product_attention(*parts, attn_mask=mask)
        tokens = tokens + self.out(seen.transpose(1, 2).flatten(2))
        inner = nn.functional.gelu(self.fc1(self.norm2(tokens)), approximate="tanh")
        return tokens + self.fc2(inner)


class Transformer(nn.Module):
    """Blocks, and a normalization after the last."""

    def __init__(self, width: int, layers: int, heads: int, mlp: int) -> None:
        super().__init__()
        self.blocks = nn.ModuleList(Block(width, heads, mlp) for _ in range(layers))
        self.norm = nn.LayerNorm(width, eps=EPS)

    def forward(self, tokens: Tensor, mask: Tensor) -> Tensor:
        """Returns tokens (B, L, D); see :meth:`Block.forward`."""
        for block in self.blocks:
            tokens = block(tokens, mask)
        return self.norm(tokens)


def looks_at(prefix: int, groups: Sequence[tuple[Kind, int]], steps: int, *, right_groups: bool) -> Tensor:
    """Returns which token (row) may look at which (column), (L, L) bool, before padding.

    Tokens of the instruction look at each other; those of an observation at them and at observations up to
    their own; a readout at the same and at earlier readouts. Nothing looks at a readout.

    Args:
        prefix: Tokens of the instruction, which come first.
        groups: Kind and number of tokens of each group of one observation, in order.
        steps: Observations in time.
        right_groups: See :attr:`policies.octo.sizes.OctoSizes.right_groups`.
    """
    counts = [count for _, count in groups]
    places = np.arange(sum(counts))
    found = np.searchsorted(np.cumsum(counts), places, side="right" if right_groups else "left")
    kinds = np.array([kind for kind, _ in groups])[found]
    kind = np.concatenate([np.full(prefix, "task"), np.tile(kinds, steps)])
    time = np.concatenate([np.full(prefix, -1), np.repeat(np.arange(steps), len(places))])
    earlier = time[None, :] <= time[:, None]
    to_task = np.broadcast_to(kind == "task", earlier.shape)
    to_seen = np.broadcast_to(kind == "observation", earlier.shape) & (kind != "task")[:, None]
    to_readout = (kind == "readout")[None, :] & (kind == "readout")[:, None]
    return torch.from_numpy(earlier & (to_task | to_seen | to_readout))
