"""Images in memory that another process of this machine can open, so that no pipe copies them.

The memory has no name in a file system: it is gone when the processes that use it are, however they end.
"""

import contextlib
import mmap
import os
from collections.abc import Iterator, Mapping
from dataclasses import dataclass

import numpy as np


@dataclass(frozen=True, slots=True)
class Place:
    """Where images are.

    Attributes:
        path: Of their memory, while the process that made it keeps it open.
        shape: Of the images, uint8, such as (T, H, W, 3).
    """

    path: str
    shape: tuple[int, ...]

    def open(self, *, write: bool = False) -> np.ndarray:
        """Returns the images; they can be written only if that is asked for."""
        with open(self.path, "r+b" if write else "rb") as file:
            access = mmap.ACCESS_WRITE if write else mmap.ACCESS_READ
            return np.frombuffer(mmap.mmap(file.fileno(), 0, access=access), np.uint8).reshape(self.shape)


def can_share() -> bool:
    """Returns whether this system can share images; Linux can."""
    return hasattr(os, "memfd_create")


@contextlib.contextmanager
def shared(images: Mapping[str, np.ndarray]) -> Iterator[dict[str, Place]]:
    """Copies images, which need a pixel at least, to memory of their own, and yields where each are.

    Args:
        images: Camera to images (T, H, W, 3) uint8.
    """
    with contextlib.ExitStack() as stack:
        places = {}
        for camera, values in images.items():
            file, places[camera] = stack.enter_context(_memory(camera, values.shape))
            left = memoryview(np.ascontiguousarray(values)).cast("B")
            while left:
                left = left[os.write(file, left) :]
        yield places


@contextlib.contextmanager
def to_fill(shapes: Mapping[str, tuple[int, ...]]) -> Iterator[dict[str, Place]]:
    """Makes memory for images of these shapes, all zero, and yields where each will be."""
    with contextlib.ExitStack() as stack:
        places = {}
        for camera, shape in shapes.items():
            file, places[camera] = stack.enter_context(_memory(camera, shape))
            os.truncate(file, int(np.prod(shape)))
        yield places


@contextlib.contextmanager
def _memory(name: str, shape: tuple[int, ...]) -> Iterator[tuple[int, Place]]:
    if hasattr(os, "memfd_create"):
        file = os.memfd_create(name)
        try:
            yield file, Place(f"/proc/{os.getpid()}/fd/{file}", shape)
        finally:
            os.close(file)
    else:
        raise OSError("Images are shared with processes on Linux alone; elsewhere threads are used.")
