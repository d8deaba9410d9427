"""A loss is compiled and recorded where its gradients stay those of eager code.

A fault of a compiler or of a recording shows in no loss and stops nothing: the network learns from wrong
gradients. So the first batches are computed both ways before training begins.
"""

import logging
from collections.abc import Sequence
from typing import NamedTuple

import torch
from torch import Tensor, nn

from policies.compilation import compile_objective
from policies.cuda_graphs import RecordedObjective
from policies.lerobot_policy import LeRobotPolicy

logger = logging.getLogger(__name__)

type Batch = dict[str, Tensor]

NUM_BATCHES = 3
"""Batches that are compared.

A gradient that is left unwritten is often right in the first.
"""

RELATIVE_TOLERANCE = 0.05
"""Of a parameter's gradient, by its norm, beyond the rounding of the precision that is trained in."""

ABSOLUTE_TOLERANCE = 1e-3
"""Of the norm of all gradients together: a gradient smaller than this is rounding."""


class Disagreement(NamedTuple):
    """A gradient that a fast form of a loss changes.

    Attributes:
        parameter: Of which it is.
        error: How far it is from that of eager code in fp32, per norm of the latter; NaN if it is NaN.
        allowed: How far it may be.
    """

    parameter: str
    error: float
    allowed: float


def fast_objective(
    policy: LeRobotPolicy, batches: Sequence[Batch], precision: str, *, compile: bool, cuda_graphs: bool
) -> nn.Module:
    """Returns a policy's loss in the fastest of the wanted forms that changes no gradient.

    The parameters' gradients are cleared; running statistics are left as they were.

    Args:
        policy: A policy that is ready for training.
        batches: Batches as training has them, at least two.
        precision: ``"bf16"`` or ``"fp32"``: what training computes in.
        compile: As one graph of ``torch.compile``.
        cuda_graphs: Played back from a recording; see :class:`policies.cuda_graphs.RecordedObjective`.
    """
    eager = policy.objective()

    def checked(candidate: nn.Module, otherwise: nn.Module, maker: str, key: str) -> nn.Module:
        device = policy.device.type
        wrong = first_disagreement(policy.model, eager, candidate, batches, precision, device)
        if wrong is None:
            return candidate
        logger.warning(
            "%s of PyTorch %s changes the gradient of '%s' of policy=%s by %.0f %%, where %.0f %% is "
            "rounding: training goes on without it, more slowly. %s=false does not try.",
            maker,
            torch.__version__,
            wrong.parameter,
            policy.name,
            100.0 * wrong.error,
            100.0 * wrong.allowed,
            key,
        )
        return otherwise

    chosen: nn.Module = eager
    if compile:
        candidate = policy.objective()
        compile_objective(candidate)
        chosen = checked(candidate, chosen, "torch.compile", "train.compile")
    if cuda_graphs:
        candidate = RecordedObjective(chosen, batches[0], precision)
        chosen = checked(candidate, chosen, "A CUDA graph", "train.cuda_graphs")
    return chosen


def first_disagreement(
    model: nn.Module,
    eager: nn.Module,
    fast: nn.Module,
    batches: Sequence[Batch],
    precision: str,
    device: str,
) -> Disagreement | None:
    """Returns the first gradient that a fast form of a loss changes, or None.

    The measure is eager code in fp32: a gradient in bf16 may be as far from it as twice what eager code in
    bf16 is, and :data:`RELATIVE_TOLERANCE` of it.

    Args:
        model: Whose parameters are trained.
        eager: Raw frames to loss.
        fast: The same, compiled or recorded.
        batches: Raw frames.
        precision: ``"bf16"`` or ``"fp32"``.
        device: Type of the device.
    """
    kept = {name: buffer.clone() for name, buffer in model.named_buffers()}
    try:
        for seed, batch in enumerate(batches):
            exact = _gradients(model, eager, batch, "fp32", device, seed)
            plain = exact if precision == "fp32" else _gradients(model, eager, batch, precision, device, seed)
            given = _gradients(model, fast, batch, precision, device, seed)
            scale = torch.stack([gradient.norm() for gradient in exact.values()]).norm()
            for name, gradient in exact.items():
                rounding = 2.0 * (plain[name] - gradient).norm()
                allowed = rounding + RELATIVE_TOLERANCE * gradient.norm() + ABSOLUTE_TOLERANCE * scale
                error = (given.get(name, torch.nan) - gradient).norm()
                if not error <= allowed:  # NaN is not <=
                    norm = gradient.norm().clamp(min=ABSOLUTE_TOLERANCE * scale)
                    return Disagreement(name, float(error / norm), float(allowed / norm))
        return None
    finally:
        with torch.no_grad():
            for name, buffer in model.named_buffers():
                buffer.copy_(kept[name])
        model.zero_grad(set_to_none=True)


def _gradients(
    model: nn.Module, objective: nn.Module, batch: Batch, precision: str, device: str, seed: int
) -> dict[str, Tensor]:
    """Returns the gradient of each parameter, in fp32; what is random is drawn from ``seed``."""
    model.zero_grad(set_to_none=True)
    torch.manual_seed(seed)
    with torch.autocast(device, torch.bfloat16, enabled=precision == "bf16"):
        loss, _terms = objective(batch)
    loss.backward()
    return {
        name: parameter.grad.float().clone()
        for name, parameter in model.named_parameters()
        if parameter.grad is not None
    }
