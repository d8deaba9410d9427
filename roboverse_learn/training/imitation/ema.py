"""Exponential moving average of weights."""

from collections.abc import Mapping

import torch
from torch import Tensor


class Ema:
    """Average of the weights with a decay that warms up, as Diffusion Policy has it.

    After ``t`` updates the decay is ``1 - (1 + t) ** -power``, at most ``max_decay`` (diffusers'
    ``EMAModel`` with ``inv_gamma=1``; arXiv:2303.04137, appendix), and ``average = decay * average +
    (1 - decay) * weights``. The first update takes the weights themselves.

    Args:
        weights: Named tensors; those that are not floating point are copied, not averaged.
        power: Exponent of the warm-up.
        max_decay: Largest decay.
        num_updates: Updates that ``weights`` is the average of already.
    """

    def __init__(
        self, weights: Mapping[str, Tensor], power: float, max_decay: float, num_updates: int = 0
    ) -> None:
        self.power = power
        self.max_decay = max_decay
        self.num_updates = num_updates
        self.average = {key: value.detach().clone() for key, value in weights.items()}

    def decay(self) -> float:
        """Returns the decay of the next update."""
        return min(self.max_decay, 1.0 - (1.0 + self.num_updates) ** -self.power)

    def next_share(self) -> float:
        """Counts one more update; returns the share of the weights in it."""
        share = 1.0 - self.decay()
        self.num_updates += 1
        return share

    @torch.no_grad()
    def update(self, weights: Mapping[str, Tensor], share: Tensor | None = None) -> None:
        """Takes the weights after one more gradient step into the average.

        Args:
            weights: The named tensors.
            share: What :meth:`next_share` returned, where the update is recorded and its numbers are given.
        """
        averaged = [key for key, average in self.average.items() if average.is_floating_point()]
        averages, latest = [self.average[key] for key in averaged], [weights[key] for key in averaged]
        # Few calls for all tensors: on a GPU a call for each would take longer than the gradient step.
        if share is None:
            torch._foreach_lerp_(averages, latest, self.next_share())  # pyright: ignore[reportPrivateImportUsage]
        else:
            moves = torch._foreach_sub(latest, averages)  # pyright: ignore[reportPrivateImportUsage]
            torch._foreach_mul_(moves, share)  # pyright: ignore[reportPrivateImportUsage]
            torch._foreach_add_(averages, moves)  # pyright: ignore[reportPrivateImportUsage]
        for key in self.average.keys() - set(averaged):
            self.average[key].copy_(weights[key])
