"""Muon for the matrices of linear layers, AdamW for everything else.

Muon (https://kellerjordan.github.io/posts/muon) replaces the momentum of a weight matrix by the nearest
semi-orthogonal matrix, so that every direction learns at the same rate. With it the small ACT of
``preset=quick`` needs half of the steps.

``torch.optim.Muon`` computes in bfloat16, which processors without such instructions emulate: a step of that
network's matrices takes ten times as long there as here.
"""

from collections import defaultdict
from collections.abc import Sequence
from typing import Any

import torch
from torch import Tensor

MOMENTUM = 0.95
"""Decay of the momentum, Nesterov's (the value of the authors)."""

_COEFFICIENTS = (3.4445, -4.7750, 2.0315)
"""Of the quintic Newton-Schulz iteration (the authors'): singular values end between 0.7 and 1.2."""

_ITERATIONS = 5
_RMS = 0.2
"""Root mean square of an update at learning rate 1: AdamW's typical one (arXiv:2502.16982, section 2.2)."""


class MuonAdamW(torch.optim.AdamW):
    """AdamW that updates the parameters of groups with ``muon=True`` by Muon.

    Args:
        groups: Parameter groups. Those with ``muon=True`` hold matrices (rows, columns) alone.
        **options: Of :class:`torch.optim.AdamW`.
    """

    def __init__(self, groups: list[dict[str, Any]], **options: Any) -> None:
        super().__init__(groups, **options)

    @torch.no_grad()
    def step(self, closure: Any = None) -> Any:
        """Takes one step; the gradients of the matrices are dropped afterwards."""
        for group in self.param_groups:
            if not group.get("muon"):
                continue
            matrices = [matrix for matrix in group["params"] if matrix.grad is not None]
            updates = orthogonalized([self._momentum(matrix) for matrix in matrices])
            for matrix, update in zip(matrices, updates, strict=True):
                scale = _RMS * max(matrix.shape) ** 0.5
                matrix.mul_(1.0 - group["lr"] * group["weight_decay"])
                matrix.add_(update, alpha=-group["lr"] * scale)
                matrix.grad = None  # AdamW passes over parameters without a gradient
        return super().step(closure)

    def _momentum(self, matrix: Tensor) -> Tensor:
        """Returns the look-ahead momentum of a matrix, and updates what it is made of."""
        state, gradient = self.state[matrix], matrix.grad
        assert gradient is not None, "matrices without a gradient are passed over"
        if not state:
            state["step"] = torch.zeros(())  # AdamW expects one when it is loaded
            state["exp_avg"] = torch.zeros_like(matrix)
        state["step"] += 1
        state["exp_avg"].lerp_(gradient, 1.0 - MOMENTUM)
        return gradient.lerp(state["exp_avg"], MOMENTUM)


def orthogonalized(matrices: Sequence[Tensor]) -> list[Tensor]:
    """Returns the approximately nearest semi-orthogonal matrix of each matrix (rows, columns).

    The Newton-Schulz iteration multiplies a matrix by polynomials of its Gram matrix. They commute, so they
    are collected on the smaller side, for all matrices of one size together.
    """
    wide = [(x.T if x.shape[0] > x.shape[1] else x) for x in matrices]
    wide = [x / (x.norm() + 1e-7) for x in wide]
    of_size: dict[int, list[int]] = defaultdict(list)
    for index, x in enumerate(wide):
        of_size[x.shape[0]].append(index)
    results = list(wide)
    for indices in of_size.values():
        factors = _polynomial(torch.stack([wide[index] @ wide[index].T for index in indices]))
        for index, factor in zip(indices, factors, strict=True):
            results[index] = factor @ wide[index]
    return [
        result.T if matrix.shape[0] > matrix.shape[1] else result
        for matrix, result in zip(matrices, results, strict=True)
    ]


def _polynomial(gram: Tensor) -> Tensor:
    """Returns the product (N, d, d) of the iteration's polynomials of Gram matrices (N, d, d)."""
    a, b, c = _COEFFICIENTS
    identity = torch.eye(gram.shape[-1], device=gram.device, dtype=gram.dtype)
    product = identity.expand_as(gram)
    for i in range(_ITERATIONS):
        factor = torch.baddbmm(a * identity + b * gram, gram, gram, alpha=c)
        product = factor if i == 0 else product @ factor
        if i < _ITERATIONS - 1:
            gram = gram @ (factor @ factor)
    return product
