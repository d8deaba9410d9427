"""Functions of tensors as CUDA graphs: one launch in place of thousands.

``tensordict.nn.CudaGraphModule`` and ``torch.cuda.make_graphed_callables`` record, too. The first waits for
the GPU at every call, so that the host is never ahead of it; the second is for what has gradients.
"""

import gc
from collections.abc import Callable
from typing import Any, cast

import torch
from torch import Tensor, nn
from torch.utils import _pytree as pytree

from policies.objective import Loss

WARMUP_CALLS = 3
"""Calls before the recording: in them, the compiler compiles and the optimizers make their moments."""


class Recorded[T]:
    """A function whose first calls are recorded as a CUDA graph, which is played back from then on.

    Nothing waits for a result. Random numbers are those of the function itself, from the generator's state
    at the call; parameters and buffers that it writes to must stay where they are.

    Args:
        function: A function of tensors on a GPU, of shapes that never change. It returns tensors: one, or
            tuples, lists or dictionaries of them.
    """

    def __init__(self, function: Callable[..., T]) -> None:
        self._function = function
        self._calls = 0
        self._graph: torch.cuda.CUDAGraph | None = None
        self._inputs: list[Tensor] = []
        self._results: T | None = None

    def __call__(self, *arguments: Tensor) -> T:
        """Returns what the function returns; the tensors are the caller's."""
        self._calls += 1
        if self._calls < WARMUP_CALLS:
            return self._warmed_up(*arguments)
        if self._graph is None:
            self._graph = self._record(arguments)
        elif len(arguments) != len(self._inputs):
            raise TypeError(f"{len(self._inputs)} tensors were recorded, and {len(arguments)} are given.")
        else:
            torch._foreach_copy_(self._inputs, list(arguments))  # pyright: ignore[reportPrivateImportUsage]
        self._graph.replay()
        return pytree.tree_map(torch.clone, self._results)

    def _warmed_up(self, *arguments: Tensor) -> T:
        """Calls the function in another stream, as the recording will."""
        stream, here = torch.cuda.Stream(), torch.cuda.current_stream()
        stream.wait_stream(here)
        with torch.cuda.stream(stream):
            results = self._function(*arguments)
        here.wait_stream(stream)
        return results

    def _record(self, arguments: tuple[Tensor, ...]) -> torch.cuda.CUDAGraph:
        self._inputs = [argument.clone() for argument in arguments]
        gc.collect()  # a graph that is no longer used would break the recording if it were freed amid it
        graph = torch.cuda.CUDAGraph()
        with torch.cuda.graph(graph):
            self._results = self._function(*self._inputs)
        return graph


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
