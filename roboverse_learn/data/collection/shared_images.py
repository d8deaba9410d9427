"""Images in memory that another process of this machine can open, so that no pipe copies them.

The memory has no name in a file system: it is gone when the process that made it is, however that ends.
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
        shape: (T, H, W, 3) uint8.
    """

    path: str
    shape: tuple[int, ...]

    def open(self) -> np.ndarray:
        """Returns the images; they cannot be written."""
        with open(self.path, "rb") as file:
            return np.frombuffer(mmap.mmap(file.fileno(), 0, access=mmap.ACCESS_READ), np.uint8).reshape(
                self.shape
            )


@contextlib.contextmanager
def shared(images: Mapping[str, np.ndarray]) -> Iterator[dict[str, Place]]:
    """Copies images, which need a pixel at least, to memory of their own, and yields where each are.

    Args:
        images: Camera to images (T, H, W, 3) uint8.
    """
    places: dict[str, Place] = {}
    with contextlib.ExitStack() as stack:
        for camera, values in images.items():
            if hasattr(os, "memfd_create"):
                file = os.memfd_create(camera)
                stack.callback(os.close, file)
                left = memoryview(np.ascontiguousarray(values)).cast("B")
                while left:
                    left = left[os.write(file, left) :]
                places[camera] = Place(f"/proc/{os.getpid()}/fd/{file}", values.shape)
            else:
                raise OSError(
                    "Images are shared with processes on Linux alone; elsewhere threads encode them."
                )
        yield places
