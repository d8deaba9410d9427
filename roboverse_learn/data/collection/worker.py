"""Worker processes of a collection: simulate, encode, and stage batches of pool episodes."""

import os
import signal
import threading
import traceback
from collections import deque
from collections.abc import Iterator, Sequence
from concurrent.futures import Future, ThreadPoolExecutor
from multiprocessing import parent_process
from pathlib import Path
from typing import Any

from envs.core.errors import DatasetError, RoboVerseError
from roboverse_learn.data.collection.config import CollectionConfig
from roboverse_learn.data.dataset.schema import EpisodeData, check_episode
from roboverse_learn.data.dataset.staging import stage_episode, staged_directory
from roboverse_learn.data.sources.base import EpisodeSource

Attempt = tuple[int, Path | None]
"""A pool index and its staged folder, or None where the demonstrator failed."""

_process: dict[str, Any] = {}


def start(config: CollectionConfig, log: Path) -> None:
    """Prepares a worker process, which logs to a file and ends when its parent does, however that ends."""
    signal.signal(signal.SIGINT, signal.SIG_IGN)  # Ctrl-C is for the collecting process, which ends this one
    threading.Thread(target=_exit_with_parent, daemon=True).start()
    _process.update(config=config, log=log / f"worker_{os.getpid()}.log")
    with open(_process["log"], "wb") as file:
        os.dup2(file.fileno(), 1)
        os.dup2(file.fileno(), 2)


def _exit_with_parent() -> None:
    parent = parent_process()
    assert parent is not None
    parent.join()
    os._exit(1)


def work(indices: Sequence[int]) -> list[Attempt]:
    """Runs one batch in a worker process.

    Raises:
        DatasetError: The source or the disk failed.
    """
    name = f"collection worker {os.getpid()}"
    try:
        if "source" not in _process:
            _process["source"] = _process["config"].make_source()
        return list(run_batch(_process["config"], _process["source"], indices, threads=1))
    except RoboVerseError as error:
        raise DatasetError(f"{error} ({name})") from None
    except Exception as error:
        traceback.print_exc()
        raise DatasetError(
            f"{type(error).__name__}: {error} ({name}). Its log is '{_process['log']}'."
        ) from None


def run_batch(
    config: CollectionConfig, source: EpisodeSource, indices: Sequence[int], threads: int
) -> Iterator[Attempt]:
    """Runs pool episodes and stages the successful ones, in threads beside the simulation.

    Raises:
        DatasetError: An episode does not fit the dataset, an index is missing, or the disk is full.
    """

    def stage(index: int, episode: EpisodeData | None) -> Attempt:
        if episode is None:
            return index, None
        check_episode(episode, config.features)
        directory = staged_directory(Path(config.root), index)
        return index, stage_episode(directory, episode, config.fps, config.encoder).directory

    missing, pending = set(indices), deque[Future[Attempt]]()
    with ThreadPoolExecutor(threads) as pool:
        for index, episode in source.attempts(indices):
            found = index if episode is None else episode.metadata.get("episode")
            if index not in missing or found != index:
                raise DatasetError(
                    f"The source was to yield the pool episodes {list(indices)} and yielded "
                    f"{index} with metadata['episode'] = {found!r}. They must be the same, and each once."
                )
            missing.discard(index)
            pending.append(pool.submit(stage, index, episode))
            while pending and (pending[0].done() or len(pending) > 2 * threads):
                yield pending.popleft().result()
        while pending:
            yield pending.popleft().result()
    if missing:
        raise DatasetError(f"The source took the pool episodes {sorted(missing)} and never yielded them.")
