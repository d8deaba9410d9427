"""Rewards and values as distributions over bins: discrete regression in symlog space."""

import torch
from torch import Tensor, nn
from torch.nn import functional

from envs.core.errors import PolicyError
from envs.core.extras import install_command

try:
    from torchrl.modules.functional import symexp, symlog
    from torchrl.modules.models.model_based import two_hot_decode, two_hot_encode
except ModuleNotFoundError as error:
    raise PolicyError(
        "policy=tdmpc2 needs the package 'torchrl', which is not installed. Install it with: "
        f"{install_command('torchrl')}."
    ) from error


class TwoHot(nn.Module):
    """Numbers to distributions over two neighbouring bins, and back (arXiv:2310.16828, appendix C.2).

    Args:
        num_bins: Bins, evenly spaced in symlog space.
        limit: They range from ``-limit`` to ``limit``.
    """

    bins: Tensor

    def __init__(self, num_bins: int, limit: float) -> None:
        super().__init__()
        self.register_buffer("bins", torch.linspace(-limit, limit, num_bins), persistent=False)

    def encode(self, values: Tensor) -> Tensor:
        """Returns the distributions (..., num_bins) of values (...)."""
        return two_hot_encode(symlog(values), self.bins)

    def decode(self, logits: Tensor) -> Tensor:
        """Returns the values (...) of logits (..., num_bins)."""
        return symexp(two_hot_decode(logits, self.bins))

    def loss(self, logits: Tensor, values: Tensor) -> Tensor:
        """Returns the cross-entropy (...) of logits (..., num_bins) with what encodes values (...)."""
        return -(self.encode(values) * functional.log_softmax(logits, dim=-1)).sum(-1)
