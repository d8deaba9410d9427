"""Functions of tensors as CUDA graphs: one launch in place of thousands."""

from collections.abc import Callable
from typing import Any, cast

WARMUP_CALLS = 3
"""Calls before the recording: in them, the compiler compiles and the optimizers make their moments."""


def recorded[T](function: Callable[..., T]) -> Callable[..., T]:
    """Returns a function that records its first calls as a CUDA graph, and replays it from then on.

    Its arguments are tensors whose shapes never change; it waits for no result, and what it writes to
    stays where it is. What it returns is overwritten by the next call.
    """
    from tensordict.nn import CudaGraphModule

    return cast(Callable[..., T], CudaGraphModule(cast(Any, function), warmup=WARMUP_CALLS))
