"""CPU cores and memory available to this process, on every operating system."""

import contextlib
import ctypes
import os
import sys
from collections.abc import Iterator

from envs.core.errors import ConfigError


def num_cores() -> int:
    """Returns the CPU cores that this process may use."""
    return len(os.sched_getaffinity(0)) if hasattr(os, "sched_getaffinity") else os.cpu_count() or 1


def check_device_name(device: str) -> None:
    """Checks the name of a torch device, without torch.

    Args:
        device: ``auto`` (a GPU if there is one), ``cpu``, ``cuda`` or ``cuda:<index>``.

    Raises:
        ConfigError: if it is none of these.
    """
    kind, _, index = device.partition(":")
    if kind not in ("auto", "cpu", "cuda") or (index and not (kind == "cuda" and index.isdigit())):
        raise ConfigError(f"Unknown device '{device}'. Valid: auto, cpu, cuda, cuda:<index>.")


def use_one_core() -> None:
    """Keeps this process on the first of its cores, where the system can."""
    if hasattr(os, "sched_setaffinity"):
        os.sched_setaffinity(0, {min(os.sched_getaffinity(0))})


@contextlib.contextmanager
def scheduling_kept() -> Iterator[None]:
    """Gives the calling thread its scheduling policy back, where the system has such policies.

    SVT-AV1, LeRobot's default video encoder, makes the thread of a root user that calls it real-time for
    good (``SCHED_FIFO``, priority 99). Processes that this thread starts inherit that, and as many busy ones
    as there are cores leave nothing to any other process.
    """
    if hasattr(os, "sched_getscheduler"):
        policy, param = os.sched_getscheduler(0), os.sched_getparam(0)
        try:
            yield
        finally:
            if os.sched_getscheduler(0) != policy:
                os.sched_setscheduler(0, policy, param)
    else:
        yield


_WAIT_SETTINGS = ("OMP_WAIT_POLICY", "GOMP_SPINCOUNT", "KMP_BLOCKTIME")

_SPINS = "5000"
"""Rounds that a thread of GNU's OpenMP spins before it sleeps (docs/speed.md)."""


def let_waiting_threads_sleep() -> None:
    """Lets OpenMP's threads sleep soon while they wait, unless the user has set how they wait.

    By default they spin for milliseconds. A thread that spins on the core that the other one needs makes
    PyTorch slower by a factor of ten and more where other processes keep the cores busy. With GNU's runtime
    (in PyTorch's wheels for Linux) a few microseconds of spinning keep 0.94 of the speed of idle cores, where
    none keeps 0.6. LLVM's (macOS) and Intel's (Windows) read ``OMP_WAIT_POLICY`` alone. It holds for this
    process, if torch is not imported yet, and for those that it starts.
    """
    if not any(name in os.environ for name in _WAIT_SETTINGS):
        os.environ |= {"OMP_WAIT_POLICY": "PASSIVE", "GOMP_SPINCOUNT": _SPINS}


_M_TRIM_THRESHOLD, _M_MMAP_THRESHOLD = -1, -3
"""Of glibc's ``mallopt``."""
_KEPT_BYTES, _KEPT_BLOCK_BYTES = 256 << 20, 32 << 20


def keep_freed_memory() -> None:
    """Keeps up to 256 MB that this process frees for what it allocates next, unless the user says otherwise.

    Training frees as much in every step as it allocates in the next. glibc gives it back in between, and the
    system maps it again page by page, one thread at a time: a twentieth of a step of a small network.
    Other C libraries are left as they are.
    """
    if sys.platform != "linux" or "GLIBC_TUNABLES" in os.environ:
        return
    if any(name.startswith("MALLOC_") for name in os.environ):
        return
    mallopt = getattr(ctypes.CDLL(None), "mallopt", None)
    if mallopt is not None:
        mallopt(_M_MMAP_THRESHOLD, _KEPT_BLOCK_BYTES)
        mallopt(_M_TRIM_THRESHOLD, _KEPT_BYTES)
