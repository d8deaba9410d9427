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

    def make_capturable(self) -> None:
        """Readies the optimizer for steps in a CUDA graph, whose learning rates are tensors."""
        for group in self.param_groups:
            group["capturable"] = True
        self._warned_capturable_if_run_uncaptured = True  # PyTorch warns of the first steps otherwise

    @torch.no_grad()
    def step(self, closure: Any = None) -> Any:
        """Takes one step; the gradients of the matrices are dropped afterwards."""
        for group in self.param_groups:
            if not group.get("muon"):
                continue
            matrices = [matrix for matrix in group["params"] if matrix.grad is not None]
            if not matrices:
                continue
            updates = orthogonalized(self._momenta(matrices))
            scales = [_RMS * max(matrix.shape) ** 0.5 for matrix in matrices]
            rate, decay = group["lr"], group["weight_decay"]
            if isinstance(rate, Tensor):  # of a recorded step, whose number changes: few calls for all
                torch._foreach_mul_(matrices, 1.0 - rate * decay)  # pyright: ignore[reportPrivateImportUsage]
                torch._foreach_mul_(updates, scales)  # pyright: ignore[reportPrivateImportUsage]
                torch._foreach_mul_(updates, -rate)  # pyright: ignore[reportPrivateImportUsage]
                torch._foreach_add_(matrices, updates)  # pyright: ignore[reportPrivateImportUsage]
            else:
                for matrix, update, scale in zip(matrices, updates, scales, strict=True):
                    matrix.mul_(1.0 - rate * decay)
                    matrix.add_(update, alpha=-rate * scale)
            for matrix in matrices:
                matrix.grad = None  # AdamW passes over parameters without a gradient
        return super().step(closure)

    def _momenta(self, matrices: Sequence[Tensor]) -> list[Tensor]:
        """Returns the look-ahead momenta of matrices, and updates what they are made of."""
        gradients, averages, counts = [], [], []
        for matrix in matrices:
            state, gradient = self.state[matrix], matrix.grad
            assert gradient is not None, "matrices without a gradient are passed over"
            if not state:
                state["step"] = torch.zeros((), device=matrix.device)  # AdamW expects one when it is loaded
                state["exp_avg"] = torch.zeros_like(matrix)
            gradients.append(gradient)
            averages.append(state["exp_avg"])
            counts.append(state["step"])
        torch._foreach_add_(counts, 1.0)  # pyright: ignore[reportPrivateImportUsage]
        torch._foreach_lerp_(averages, gradients, 1.0 - MOMENTUM)  # pyright: ignore[reportPrivateImportUsage]
        return list(torch._foreach_lerp(gradients, averages, MOMENTUM))  # pyright: ignore[reportPrivateImportUsage]


def orthogonalized(matrices: Sequence[Tensor]) -> list[Tensor]:
    """Returns the approximately nearest semi-orthogonal matrix of each matrix (rows, columns).

    The Newton-Schulz iteration multiplies a matrix by polynomials of its Gram matrix. They commute, so they
    are collected on the smaller side, for all matrices of one size together. Few large calls leave little to
    do between them, where a processor's other threads would wait.
    """
    of_shape: dict[tuple[int, int], list[int]] = defaultdict(list)
    for index, matrix in enumerate(matrices):
        of_shape[matrix.shape[0], matrix.shape[1]].append(index)
    stacks = {shape: _normalized(torch.stack([matrices[i] for i in of_shape[shape]])) for shape in of_shape}
    of_size: dict[int, list[tuple[int, int]]] = defaultdict(list)
    for shape in stacks:
        of_size[min(shape)].append(shape)
    results: dict[int, Tensor] = {}
    for shapes in of_size.values():
        factors = _polynomial(torch.cat([_gram(stacks[shape]) for shape in shapes]))
        parts = factors.split([len(stacks[shape]) for shape in shapes])
        for shape, factor in zip(shapes, parts, strict=True):
            x = stacks[shape]
            update = x @ factor if _is_tall(x) else factor @ x
            results |= zip(of_shape[shape], update, strict=True)
    return [results[index] for index in range(len(matrices))]


def _normalized(x: Tensor) -> Tensor:
    """Divides matrices (N, rows, columns) in place by their norms."""
    return x.div_(torch.linalg.vector_norm(x, dim=(1, 2), keepdim=True) + 1e-7)


def _gram(x: Tensor) -> Tensor:
    """Returns the Gram matrices of the smaller side of matrices (N, rows, columns)."""
    return x.mT @ x if _is_tall(x) else x @ x.mT


def _is_tall(x: Tensor) -> bool:
    return x.shape[-2] > x.shape[-1]


def _polynomial(gram: Tensor) -> Tensor:
    """Returns the product (N, d, d) of the iteration's polynomials of Gram matrices (N, d, d)."""
    a, b, c = _COEFFICIENTS
    product = gram
    for i in range(_ITERATIONS):
        factor = torch.baddbmm(gram, gram, gram, beta=b, alpha=c)
        factor.diagonal(dim1=-2, dim2=-1).add_(a)
        product = factor if i == 0 else product @ factor
        if i < _ITERATIONS - 1:
            gram = gram @ (factor @ factor)
    return product
