"""Warp without what it prints."""

import contextlib
import functools
import os
import tempfile
from collections.abc import Iterator
from typing import Any

_NO_GPU = (b"Could not find or load the NVIDIA CUDA driver", b"Warp CUDA error 100:")
"""What Warp prints without the driver, and with one that shows no device (CUDA_ERROR_NO_DEVICE)."""


@functools.cache
def start_warp() -> Any:
    """Initializes Warp and returns its module; on a machine without a GPU it says nothing about that."""
    import warp as wp

    wp.config.log_level = wp.LOG_WARNING
    with _stderr_without(*_NO_GPU):  # the library itself prints it, whatever its level of logging
        wp.init()
    return wp


@contextlib.contextmanager
def _stderr_without(*words: bytes) -> Iterator[None]:
    """Leaves lines with any of these words out of what is printed to the standard error, by libraries too."""
    try:
        kept = os.dup(2)
    except OSError:  # it is closed
        yield
        return
    with tempfile.TemporaryFile() as file:
        os.dup2(file.fileno(), 2)
        try:
            yield
        finally:
            os.dup2(kept, 2)
            os.close(kept)
            file.seek(0)
            for line in file:
                if not any(word in line for word in words):
                    os.write(2, line)
