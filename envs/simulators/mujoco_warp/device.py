"""The device that Warp and torch share: which one, on which stream, and graphs of launches on it."""

import contextlib
import gc
import io
import logging
from collections.abc import Callable, Iterator
from typing import Any

import torch
import warp as wp
from torch import Tensor

from envs.core.errors import SimulatorError
from envs.start_warp import start_warp

logger = logging.getLogger(__name__)

_SIGNED = {torch.uint16: torch.int16, torch.uint32: torch.int32, torch.uint64: torch.int64}


class Device:
    """One device, under both names.

    Args:
        name: ``auto`` (the current GPU if there is one, otherwise the CPU), ``cpu``, ``cuda`` or ``cuda:1``.

    Attributes:
        torch: The device for torch.
        warp: The device for Warp.

    Raises:
        SimulatorError: if there is no such device.
    """

    def __init__(self, name: str = "auto") -> None:
        start_warp()
        gpus = wp.get_cuda_device_count() if torch.cuda.is_available() else 0
        valid = ["auto", "cpu", *(["cuda"] if gpus else []), *(f"cuda:{index}" for index in range(gpus))]
        if name not in valid:
            raise SimulatorError(
                f"There is no device '{name}' for simulator=mujoco_warp here. Valid: {', '.join(valid)}."
            )
        if name == "auto":
            name = "cuda" if gpus else "cpu"
        if name == "cuda":
            name = f"cuda:{torch.cuda.current_device()}"
        self.torch = torch.device(name)
        self.warp: Any = wp.get_device(name)

    @property
    def is_cuda(self) -> bool:
        """Whether it is a GPU."""
        return self.torch.type == "cuda"

    @contextlib.contextmanager
    def scope(self) -> Iterator[None]:
        """Makes Warp use this device, and on a GPU torch's present stream, so neither waits for the other."""
        with contextlib.ExitStack() as stack:
            stack.enter_context(wp.ScopedDevice(self.warp))
            if self.is_cuda:
                stack.enter_context(torch.cuda.device(self.torch))
                stack.enter_context(wp.ScopedStream(self._stream(), sync_enter=False))
            yield

    def _stream(self) -> Any:
        return wp.stream_from_torch(torch.cuda.current_stream(self.torch))

    def capture(self, launches: Callable[[], object]) -> "Graph":
        """Records what ``launches`` does on this device, without doing it."""
        with contextlib.ExitStack() as stack:
            stack.enter_context(wp.ScopedDevice(self.warp))
            if self.is_cuda:
                # A CUDA graph of torch, a policy's, that is no longer used breaks the capture if it is freed
                # amid it; it is part of a cycle, so the collector would free it at any time. To collect first
                # takes 0.7 s beside a policy.
                stack.enter_context(_collector_off())
                # A capture cannot be made in the default stream, which is usually torch's.
                torch.cuda.synchronize(self.torch)
                stack.enter_context(torch.cuda.device(self.torch))
                stack.enter_context(wp.ScopedStream(wp.Stream(self.warp)))
            stack.enter_context(contextlib.redirect_stdout(io.StringIO()))
            capture = stack.enter_context(wp.ScopedCapture(device=self.warp))
            launches()
        return Graph(capture.graph, self)

    def synchronize(self) -> None:
        """Waits until everything is done."""
        if self.is_cuda:
            torch.cuda.synchronize(self.torch)

    def tensor(self, array: Any) -> Tensor:
        """Returns a Warp array as a tensor of the same memory; a vector's entries are its last axis.

        Unsigned integers become signed ones of the same bits: CUDA cannot index or compare the former.
        """
        if array.size == 0:
            return torch.zeros((*array.shape, *getattr(array.dtype, "_shape_", ())), device=self.torch)
        tensor = wp.to_torch(array)
        return tensor.view(_SIGNED[tensor.dtype]) if tensor.dtype in _SIGNED else tensor

    def rows(self, env_ids: Any) -> Any:
        """Returns environment indices in the form that indexes tensors of this device fastest."""
        return slice(None) if env_ids is None else torch.as_tensor(env_ids, device=self.torch).long()


@contextlib.contextmanager
def _collector_off() -> Iterator[None]:
    """Frees nothing that is part of a cycle."""
    was_on = gc.isenabled()
    gc.disable()
    try:
        yield
    finally:
        if was_on:
            gc.enable()


class Graph:
    """Launches that were recorded once, and are replayed as one."""

    def __init__(self, graph: Any, device: Device) -> None:
        self._graph, self._device = graph, device

    def launch(self, times: int = 1) -> None:
        """Replays it in torch's present stream."""
        stream = self._device._stream() if self._device.is_cuda else None
        for _ in range(times):
            wp.capture_launch(self._graph, stream=stream)
