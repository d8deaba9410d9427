"""Functions of tensors as CUDA graphs: one launch in place of thousands."""

import gc
from collections.abc import Callable
from typing import Any, cast

import torch
from torch import Tensor, nn

from policies.objective import Loss

WARMUP_CALLS = 3
"""Calls before the recording: in them, the compiler compiles and the optimizers make their moments."""


def recorded[T](function: Callable[..., T]) -> Callable[..., T]:
    """Returns a function that records its first calls as a CUDA graph, and replays it from then on.

    Its arguments are tensors whose shapes never change; it waits for no result, and what it writes to
    stays where it is. What it returns is overwritten by the next call.
    """
    from tensordict.nn import CudaGraphModule

    return cast(Callable[..., T], CudaGraphModule(cast(Any, function), warmup=WARMUP_CALLS))


class RecordedObjective(nn.Module):
    """A loss whose kernels, forward and backward, are recorded once and played back from then on.

    A call's loss and terms are overwritten by the next one's. Noise is sampled at each call, from the
    seed that is set before it.

    Args:
        objective: Raw frames to loss, on a GPU; it may be compiled.
        batch: Frames, of the shapes of all later ones.
        precision: ``"bf16"`` or ``"fp32"``: what is computed in.
    """

    def __init__(self, objective: nn.Module, batch: dict[str, Tensor], precision: str) -> None:
        super().__init__()
        # The recording's stream is another than training's, and the one waits for the other.
        torch.autograd.graph.set_warn_on_accumulate_grad_stream_mismatch(False)
        self.objective = objective
        sample = {key: value.clone() for key, value in batch.items()}
        kept = {name: buffer.clone() for name, buffer in objective.named_buffers()}
        device, bf16 = next(iter(sample.values())).device.type, precision == "bf16"
        gc.collect()  # a graph that is no longer used would break the recording if it were freed amid it
        with torch.autocast(device, torch.bfloat16, enabled=bf16, cache_enabled=False):
            # Replaces this module's forward by one that plays back.
            torch.cuda.make_graphed_callables(self, cast(Any, (sample,)), allow_unused_input=True)
        with torch.no_grad():  # the recording took running statistics along
            for name, buffer in objective.named_buffers():
                buffer.copy_(kept[name])

    def forward(self, batch: dict[str, Tensor]) -> Loss:
        """Returns the loss of a batch, and its terms."""
        return self.objective(batch)
