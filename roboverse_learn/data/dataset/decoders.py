"""Processes that decode videos, for one dataset or for several one after the other."""

from collections.abc import Iterable, Mapping
from concurrent.futures import Future, ProcessPoolExecutor, wait
from concurrent.futures.process import BrokenProcessPool
from multiprocessing import get_context
from pathlib import Path
from types import TracebackType
from typing import Self

import numpy as np

from envs.core.errors import DatasetError
from roboverse_learn.data.dataset.video import decode_video
from roboverse_learn.data.processes import end_with_parent, script_of_processes
from roboverse_learn.data.shared_images import Place, can_share, to_fill

FRAMES_A_PROCESS = 10_000
"""Fewer are decoded by threads: a process takes half a second to start."""

type VideoJob = tuple[Path, np.ndarray, np.ndarray]
"""A video, the times wanted from it in seconds (K,), and the frame of the dataset that each is (K,)."""


class Decoders:
    """Processes that decode videos, where they are worth their start; they start when they are first needed.

    A context manager: the processes end with it. Many threads would wait for the interpreter's lock.

    Args:
        num_images: Images to decode, of all datasets together.
        at_most: Processes.

    Attributes:
        count: Processes; 0 where threads do as well, or where images cannot be shared with processes.
    """

    def __init__(self, num_images: int, at_most: int) -> None:
        count = min(at_most, num_images // FRAMES_A_PROCESS)
        self.count = count if count > 2 and can_share() else 0
        self._pool: ProcessPoolExecutor | None = None

    def __enter__(self) -> Self:
        return self

    def __exit__(
        self, kind: type[BaseException] | None, error: BaseException | None, trace: TracebackType | None
    ) -> None:
        if self._pool is not None:
            self._pool.shutdown(cancel_futures=True)

    def decode(
        self, shapes: Mapping[str, tuple[int, int, int, int]], jobs: Mapping[str, Iterable[VideoJob]]
    ) -> dict[str, np.ndarray]:
        """Decodes the videos of one dataset.

        Args:
            shapes: Shape (N, C, H, W) of the images by key.
            jobs: The videos by key.

        Returns:
            uint8 (N, C, H, W) by key.

        Raises:
            DatasetError: A video is absent, truncated or damaged, or a process died.
        """
        if self._pool is None:
            self._pool = ProcessPoolExecutor(self.count, get_context("spawn"), end_with_parent)
        each = [(key, *job) for key in shapes for job in jobs[key]]
        pieces = [each[first :: 4 * self.count] for first in range(min(4 * self.count, len(each)))]
        with to_fill(shapes) as places:
            futures: list[Future[None]] = []
            try:
                with script_of_processes(None):
                    futures.extend(self._pool.submit(_fill, places, piece) for piece in pieces)
                for future in futures:
                    future.result()
            except BrokenProcessPool as error:
                self._pool.shutdown()  # the processes that are left still write
                why = "out of memory? Free some, or take fewer demonstrations."
                raise DatasetError(f"A process that decodes videos died; {why}") from error
            finally:  # a number of memory that is closed may soon be that of another file
                wait([future for future in futures if not future.cancel()])
            return {key: place.open(write=True) for key, place in places.items()}


def _fill(places: dict[str, Place], jobs: list[tuple[str, Path, np.ndarray, np.ndarray]]) -> None:
    """Decodes videos in one of several processes."""
    images = {key: place.open(write=True) for key, place in places.items()}
    for key, path, times, rows in jobs:
        decode_video(path, times, rows, images[key])
