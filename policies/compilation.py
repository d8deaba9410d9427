"""Calls of torch.compile."""

from collections.abc import Callable
from typing import Any, cast

INDUCTOR_OPTIONS: dict[str, bool | int] = {"triton.mix_order_reduction": False}
"""``options=`` of every ``torch.compile``.

From PyTorch 2.10 on, the compiler fuses reductions over rows with those over columns, and then leaves
unwritten the gradients that are slices of one tensor: the biases of an attention's queries, keys and values
(PyTorch issue 193061). They hold what lay in memory before. To be removed once the oldest PyTorch of
``pyproject.toml`` has the repair (PyTorch pull request 193103).
"""

OBJECTIVE_OPTIONS = INDUCTOR_OPTIONS | {"fallback_random": True}
"""Those of a loss: its noise is that of eager code."""

UNFUSED_OBJECTIVE_OPTIONS = OBJECTIVE_OPTIONS | {"epilogue_fusion": False, "max_fusion_size": 1}
"""Those of a loss with a batch normalization that is trained: nothing is fused.

With PyTorch 2.11 on an H200, compiled ACT with a trained batch normalization in bf16 has gradients that are
NaN from the second batch on, in its whole backbone, at the right loss. Of seven other settings of the
compiler (softmax, split and persistent reductions, layouts, patterns, buffers, recomputation) none changes
that; without fusion every gradient is that of eager code. With the normalization as one operator of its own
and the rest fused, the first convolution's gradient alone is wrong, by factors of a hundred to nine thousand.
:mod:`roboverse_learn.training.imitation.fast_objective` checks it.
"""


def compiled[**P, T](function: Callable[P, T]) -> Callable[P, T]:
    """Returns a function of tensors as one compiled graph for each of the shapes that it is called with.

    Not for shapes at large: with PyTorch 2.11 the compiler fails on the planning of TD-MPC2 where it is
    called with a second number of environments (``AssertionError`` in ``get_pw_red_splits``).
    """
    import torch

    return torch.compile(function, fullgraph=True, dynamic=False, options=cast(Any, INDUCTOR_OPTIONS))


def compile_objective(objective: Any) -> None:
    """Compiles a loss, a module, as one graph for batches of one shape; it is compiled when first called.

    Its gradients are to be computed outside of autocast, as PyTorch advises. The compiler otherwise computes
    those in the lower precision everywhere, also of what computes in float32 within autocast: with PyTorch
    2.11, some of mtact's are off by 40 % in bf16, where those of eager code are off by 0.3 %.
    """
    import torch._functorch.config as functorch
    from torch.nn import BatchNorm2d

    functorch.backward_pass_autocast = "off"  # of the whole process: it is read when the graph is compiled

    trains_norms = any(isinstance(module, BatchNorm2d) for module in objective.modules())
    objective.compile(
        fullgraph=True,
        dynamic=False,
        options=UNFUSED_OBJECTIVE_OPTIONS if trains_norms else OBJECTIVE_OPTIONS,
    )
