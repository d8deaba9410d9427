"""Device and precision of training."""

import contextlib
import os
from collections.abc import Iterator

import torch

from envs.core.errors import ConfigError
from envs.core.machine import check_device_name, keep_freed_memory, num_cores
from roboverse_learn.training.config import Precision


def resolve_device(device: str = "auto") -> str:
    """Returns a torch device; under ``accelerate launch`` each process takes the GPU of its own.

    Args:
        device: ``auto`` (a GPU if there is one), ``cpu``, ``cuda`` or ``cuda:<index>``.

    Raises:
        ConfigError: if there is no such device on this machine.
    """
    check_device_name(device)
    has_gpu = torch.cuda.is_available()
    if device == "auto":
        device = "cuda" if has_gpu else "cpu"
    kind, _, index = device.partition(":")
    if kind == "cuda":
        count = torch.cuda.device_count() if has_gpu else 0
        number = int(index or os.environ.get("LOCAL_RANK", 0))
        if number >= count:
            raise ConfigError(f"device='{device}' needs {number + 1} GPU(s), found {count}. Take device=cpu.")
        # Checkpoints say 'cuda', whichever GPU they come from.
        torch.cuda.set_device(number)
    return kind


def resolve_precision(precision: Precision, device: torch.device) -> str:
    """Returns ``bf16`` or ``fp32``; ``auto`` is ``bf16`` where the processor multiplies it natively.

    On a CPU without such instructions bf16 is emulated, and slower than fp32.
    """
    if precision != "auto":
        return precision
    if device.type == "cuda":
        return "bf16" if torch.cuda.is_bf16_supported(including_emulation=False) else "fp32"
    capabilities = torch.cpu.get_capabilities()
    return "bf16" if capabilities.get("avx512_bf16") or capabilities.get("amx_bf16") else "fp32"


@contextlib.contextmanager
def cpu_threads(num_threads: int, device: str = "cpu") -> Iterator[None]:
    """Sets torch's number of threads inside the block.

    Args:
        num_threads: How many; 0 takes ``OMP_NUM_THREADS``, or one per core of this process. Beside a GPU it
            takes one: all that is left to do is to gather batches, for which threads wait longer for each
            other than they work (two batches' images: 2 ms by one, 100 ms by 32 on two busy cores).
        device: Type of the device that computes.
    """
    if device == "cpu":
        keep_freed_memory()
    before = torch.get_num_threads()
    torch.set_num_threads(num_threads or (1 if device == "cuda" else _own_threads()))
    try:
        yield
    finally:
        torch.set_num_threads(before)


def _own_threads() -> int:
    given = os.environ.get("OMP_NUM_THREADS", "")
    return int(given) if given.isdigit() and int(given) else num_cores()
