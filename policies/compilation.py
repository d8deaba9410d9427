"""How torch.compile is called here."""

from collections.abc import Callable
from typing import Any, cast

INDUCTOR_OPTIONS: dict[str, bool] = {"triton.mix_order_reduction": False}
"""``options=`` of every ``torch.compile``.

From PyTorch 2.10 on, the compiler fuses reductions over rows with those over columns, and then leaves
unwritten the gradients that are slices of one tensor: the biases of an attention's queries, keys and values
(PyTorch issue 193061). They hold what lay in memory before. That is the likely cause of what was seen on an
H100 with PyTorch 2.11: compiled ACT in bf16 had gradients of norm 6,568 where eager code in fp32 has 55, at
the same loss, and learned more slowly or turned into NaN. With the fusion off, the losses of 20 steps on an
H200 are within 0.6 % of eager ones (4.7 % before; ``roboverse benchmark training``). To be removed once the
oldest PyTorch of ``pyproject.toml`` has the repair (PyTorch pull request 193103).
"""


def compiled[**P, T](function: Callable[P, T]) -> Callable[P, T]:
    """Returns a function of tensors as one compiled graph."""
    import torch

    return torch.compile(function, fullgraph=True, options=cast(Any, INDUCTOR_OPTIONS))
