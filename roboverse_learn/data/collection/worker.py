"""Worker processes of a collection: simulate, encode, and stage batches of pool episodes.

Where one process simulates, as on a GPU, others may encode for it: threads would hold up its interpreter.
"""

import os
import traceback
from collections import deque
from collections.abc import Callable, Iterable, Iterator, Mapping, Sequence
from concurrent.futures import Future, ThreadPoolExecutor
from dataclasses import replace
from pathlib import Path
from typing import Any

from envs.core.errors import DatasetError, RoboVerseError
from roboverse_learn.data.collection.config import CollectionConfig
from roboverse_learn.data.dataset.schema import EpisodeData, check_episode
from roboverse_learn.data.dataset.staging import stage_episode, staged_directory
from roboverse_learn.data.processes import end_with_parent
from roboverse_learn.data.shared_images import Place, shared
from roboverse_learn.data.sources.base import EpisodeSource

Attempt = tuple[int, Path | None]
"""A pool index and its staged folder, or None where the demonstrator failed."""

Stage = Callable[[Path, EpisodeData], Path]
"""Stages a checked episode as a folder, and returns it."""

_process: dict[str, Any] = {}


def start(config: CollectionConfig, log: Path) -> None:
    """Prepares a worker process, which logs to a file and ends when its parent does, however that ends."""
    end_with_parent()
    _process.update(config=config, log=log / f"worker_{os.getpid()}.log")
    with open(_process["log"], "wb") as file:
        os.dup2(file.fileno(), 1)
        os.dup2(file.fileno(), 2)


def work(indices: Sequence[int]) -> list[Attempt]:
    """Runs one batch in a worker process.

    Raises:
        DatasetError: The source or the disk failed.
    """
    name = f"collection worker {os.getpid()}"
    try:
        if "source" not in _process:
            _process["source"] = _process["config"].make_source()
        return list(run_batches(_process["config"], _process["source"], [indices], threads=1))
    except RoboVerseError as error:
        raise DatasetError(f"{error} ({name})") from None
    except Exception as error:
        traceback.print_exc()
        raise DatasetError(
            f"{type(error).__name__}: {error} ({name}). Its log is '{_process['log']}'."
        ) from None


def encode(directory: Path, episode: EpisodeData, images: Mapping[str, Place]) -> Path:
    """Stages an episode in a process that encodes for another.

    Args:
        directory: See :func:`~roboverse_learn.data.dataset.staging.stage_episode`.
        episode: A checked episode without its images.
        images: Where these are.
    """
    config: CollectionConfig = _process["config"]
    whole = replace(episode, images={camera: place.open() for camera, place in images.items()})
    return stage_episode(directory, whole, config.fps, config.encoder).directory


def encoded_by(submit: Callable[..., Future[Path]]) -> Stage:
    """Returns what stages an episode in a process that encodes, and waits for it.

    Args:
        submit: Of the executor whose processes encode.
    """

    def stage(directory: Path, episode: EpisodeData) -> Path:
        with shared(episode.images) as images:
            return submit(encode, directory, replace(episode, images={}), images).result()

    return stage


def run_batches(
    config: CollectionConfig,
    source: EpisodeSource,
    batches: Iterable[Sequence[int]],
    threads: int,
    stage: Stage | None = None,
) -> Iterator[Attempt]:
    """Runs pool episodes and stages the successful ones, in threads beside the simulation.

    The simulation goes on while up to half a batch of episodes is staged, also from one batch to the next.

    Args:
        config: What to collect.
        source: Runs the episodes.
        batches: Which.
        threads: How many.
        stage: What each thread does with an episode; encodes it by default.

    Raises:
        DatasetError: An episode does not fit the dataset, an index is missing, or the disk is full.
    """

    def attempt(index: int, episode: EpisodeData | None) -> Attempt:
        if episode is None:
            return index, None
        check_episode(episode, config.features)
        directory = staged_directory(Path(config.root), index)
        if stage is not None:
            return index, stage(directory, episode)
        return index, stage_episode(directory, episode, config.fps, config.encoder).directory

    pending, most = deque[Future[Attempt]](), max(2 * threads, config.batch_size // 2)
    with ThreadPoolExecutor(threads) as pool:
        try:
            for batch in batches:
                for index, episode in _checked(source, batch):
                    pending.append(pool.submit(attempt, index, episode))
                    while pending and (pending[0].done() or len(pending) > most):
                        yield pending.popleft().result()
            while pending:
                yield pending.popleft().result()
        finally:  # nobody waits for the others where this ends early
            pool.shutdown(cancel_futures=True)


def _checked(source: EpisodeSource, indices: Sequence[int]) -> Iterator[tuple[int, EpisodeData | None]]:
    """Yields a source's attempts at pool episodes.

    Raises:
        DatasetError: They are not those that were asked for.
    """
    missing = set(indices)
    for index, episode in source.attempts(indices):
        found = index if episode is None else episode.metadata.get("episode")
        if index not in missing or found != index:
            raise DatasetError(
                f"The source was to yield the pool episodes {list(indices)} and yielded "
                f"{index} with metadata['episode'] = {found!r}. They must be the same, and each once."
            )
        missing.discard(index)
        yield index, episode
    if missing:
        raise DatasetError(f"The source took the pool episodes {sorted(missing)} and never yielded them.")
