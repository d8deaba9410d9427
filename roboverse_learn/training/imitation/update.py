"""What follows the gradients of a step: clipping, the optimizer's step, and the average of the weights."""

from collections.abc import Sequence

import torch
from torch import Tensor, nn

from policies.cuda_graphs import Recorded
from policies.imitation import ImitationPolicy
from roboverse_learn.training.imitation.ema import Ema
from roboverse_learn.training.imitation.muon import MuonAdamW


class Update:
    """Applies the gradients of a policy.

    Recorded, it is one launch: a small network has so many tensors that the GPU waits for Python otherwise.

    Args:
        policy: Whose parameters have gradients when it is called.
        optimizer: Of :func:`roboverse_learn.training.imitation.optimizer.make_optimizer`.
        ema: Average of the weights, if one is kept.
        grad_clip: Largest L2 norm of all gradients together; 0 does not clip.
        record: Record it as a CUDA graph. Then the same parameters must have gradients at each call.
    """

    def __init__(
        self,
        policy: ImitationPolicy,
        optimizer: MuonAdamW,
        ema: Ema | None = None,
        *,
        grad_clip: float = 0.0,
        record: bool = False,
    ) -> None:
        self._policy, self._optimizer, self._ema = policy, optimizer, ema
        self._grad_clip = grad_clip
        self._parameters = list(policy.model.parameters())
        self._recorded = Recorded(self._take_given) if record else None
        if record:
            optimizer.make_capturable()

    def __call__(self, rate_factor: float) -> Tensor:
        """Takes one step, and clears the gradients; returns their norm before they were clipped.

        Args:
            rate_factor: What the peak learning rates are multiplied with.
        """
        rates = [group["peak_lr"] * rate_factor for group in self._optimizer.param_groups]
        if self._recorded is None:
            return self._take(rates)
        share = 1.0 if self._ema is None else self._ema.next_share()
        numbers = [torch.full((), number, device=self._policy.device) for number in (share, *rates)]
        norm = self._recorded(*numbers, *(gradient for _, gradient in self._trained()))
        self._optimizer.zero_grad()
        return norm

    def _trained(self) -> list[tuple[nn.Parameter, Tensor]]:
        """Returns the parameters that have gradients, and these."""
        return [(each, each.grad) for each in self._parameters if each.grad is not None]

    def _take_given(self, share: Tensor, *given: Tensor) -> Tensor:
        """Takes a step by given learning rates of the groups, and gradients of what has some."""
        number = len(self._optimizer.param_groups)
        rates, gradients = given[:number], given[number:]
        for (parameter, _), gradient in zip(self._trained(), gradients, strict=True):
            parameter.grad = gradient
        return self._take(rates, share)

    def _take(self, rates: Sequence[float | Tensor], share: Tensor | None = None) -> Tensor:
        for group, rate in zip(self._optimizer.param_groups, rates, strict=True):
            group["lr"] = rate
        norm = torch.zeros((), device=self._policy.device)
        if self._grad_clip:
            norm = nn.utils.clip_grad_norm_(self._parameters, self._grad_clip)
        self._optimizer.step()
        self._optimizer.zero_grad()
        if self._ema is not None:
            self._ema.update(self._policy.state_dict(), share)
        return norm
