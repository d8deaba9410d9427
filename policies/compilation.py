"""How torch.compile is called here."""

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
that; without fusion every gradient is that of eager code.
:mod:`roboverse_learn.training.compiled_objective` checks it.
"""

CUDA_GRAPH_OPTIONS: dict[str, bool | int] = {"triton.cudagraphs": True}
"""Those that besides record the kernels of a call and play them back."""


def compiled[**P, T](function: Callable[P, T]) -> Callable[P, T]:
    """Returns a function of tensors as one compiled graph."""
    import torch

    return torch.compile(function, fullgraph=True, options=cast(Any, INDUCTOR_OPTIONS))


def compile_objective(objective: Any, *, cuda_graphs: bool = False) -> None:
    """Compiles a loss, a module, as one graph for batches of one shape; it is compiled when first called.

    Args:
        objective: The loss.
        cuda_graphs: On a GPU, record the kernels of the second call, forward and backward, and play them
            back from the third on. A call's loss and terms are overwritten by the next one's.
    """
    from torch.nn import BatchNorm2d

    trains_norms = any(isinstance(module, BatchNorm2d) for module in objective.modules())
    graphs = CUDA_GRAPH_OPTIONS if cuda_graphs else {}
    objective.compile(
        fullgraph=True,
        dynamic=False,
        options=(UNFUSED_OBJECTIVE_OPTIONS if trains_norms else OBJECTIVE_OPTIONS) | graphs,
    )
