"""A loss is compiled and recorded where its gradients stay those of eager code.

A fault of a compiler or of a recording shows in no loss and stops nothing: the network learns from wrong
gradients. So the first batches are computed both ways before training begins.
"""

import logging
from collections.abc import Iterator, Sequence
from contextlib import contextmanager
from typing import NamedTuple

import torch
from torch import Tensor, nn

from policies.compilation import compile_objective
from policies.cuda_graphs import RecordedObjective
from policies.imitation import ImitationPolicy

logger = logging.getLogger(__name__)

type Batch = dict[str, Tensor]

FORMS = ((True, True), (False, True), (True, False))
"""Compiled or not, recorded or not: the fastest first, as measured (docs/speed.md)."""

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
    policy: ImitationPolicy, batches: Sequence[Batch], precision: str, *, compile: bool, cuda_graphs: bool
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
    expected = EagerGradients(policy.model, eager, batches, precision)
    for compiled, recorded in FORMS:
        if compiled > compile or recorded > cuda_graphs:
            continue  # not wanted
        candidate: nn.Module = policy.objective()
        if compiled:
            compile_objective(candidate)
        if recorded:
            candidate = RecordedObjective(candidate, batches[0], precision)
        wrong = expected.first_disagreement(candidate)
        if wrong is None:
            return candidate
        keys = [key for key, used in (("train.compile", compiled), ("train.cuda_graphs", recorded)) if used]
        logger.warning(
            "With %s PyTorch %s changes the gradient of '%s' of policy=%s by %.0f %%, where %.0f %% is "
            "rounding: training continues without, more slowly. %s=false does not try.",
            " and ".join(f"{key}=true" for key in keys),
            torch.__version__,
            wrong.parameter,
            policy.name,
            100.0 * wrong.error,
            100.0 * wrong.allowed,
            keys[0],
        )
    return eager


class EagerGradients:
    """The gradients of eager code on some batches, by which those of a fast form are judged.

    The measure is eager code in fp32: a gradient in bf16 may be as far from it as twice what eager code in
    bf16 is, and :data:`RELATIVE_TOLERANCE` of it.

    Args:
        model: Whose parameters are trained.
        eager: Raw frames to loss.
        batches: Raw frames, on the device of training.
        precision: ``"bf16"`` or ``"fp32"``.
    """

    def __init__(self, model: nn.Module, eager: nn.Module, batches: Sequence[Batch], precision: str) -> None:
        self._model, self._batches, self._precision = model, batches, precision
        self._exact: list[dict[str, Tensor]] = []
        self._rounding: list[dict[str, Tensor]] = []
        with _left_as_it_was(model):
            for seed, batch in enumerate(batches):
                exact = _gradients(model, eager, batch, "fp32", seed)
                plain = exact if precision == "fp32" else _gradients(model, eager, batch, precision, seed)
                self._exact.append(exact)
                self._rounding.append({name: (plain[name] - exact[name]).norm() for name in exact})

    def first_disagreement(self, fast: nn.Module) -> Disagreement | None:
        """Returns the first gradient that a fast form of the loss changes, or None.

        Args:
            fast: Raw frames to loss, compiled or recorded.
        """
        with _left_as_it_was(self._model):
            for seed, batch in enumerate(self._batches):
                exact, rounding = self._exact[seed], self._rounding[seed]
                given = _gradients(self._model, fast, batch, self._precision, seed)
                scale = torch.stack([gradient.norm() for gradient in exact.values()]).norm()
                for name, gradient in exact.items():
                    allowed = 2.0 * rounding[name] + RELATIVE_TOLERANCE * gradient.norm()
                    allowed = allowed + ABSOLUTE_TOLERANCE * scale
                    error = (given.get(name, torch.nan) - gradient).norm()
                    if not error <= allowed:  # NaN is not <=
                        norm = gradient.norm().clamp(min=ABSOLUTE_TOLERANCE * scale)
                        return Disagreement(name, float(error / norm), float(allowed / norm))
        return None


@contextmanager
def _left_as_it_was(model: nn.Module) -> Iterator[None]:
    """Restores running statistics and clears gradients at its end."""
    kept = {name: buffer.clone() for name, buffer in model.named_buffers()}
    try:
        yield
    finally:
        with torch.no_grad():
            for name, buffer in model.named_buffers():
                buffer.copy_(kept[name])
        model.zero_grad(set_to_none=True)


def _gradients(
    model: nn.Module, objective: nn.Module, batch: Batch, precision: str, seed: int
) -> dict[str, Tensor]:
    """Returns the gradient of each parameter, in fp32; what is random is drawn from ``seed``."""
    model.zero_grad(set_to_none=True)
    torch.manual_seed(seed)
    device = next(iter(batch.values())).device.type
    with torch.autocast(device, torch.bfloat16, enabled=precision == "bf16"):
        loss, _terms = objective(batch)
    loss.backward()
    return {
        name: parameter.grad.float().clone()
        for name, parameter in model.named_parameters()
        if parameter.grad is not None
    }
