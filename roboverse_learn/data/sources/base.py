"""Where demonstrations come from: an environment and its expert, named by a reference and JSON."""

import importlib
from collections.abc import Iterator, Mapping
from pathlib import Path
from typing import Any, Protocol

from envs.core.errors import DatasetError
from roboverse_learn.data.dataset.schema import EpisodeData, Feature, check_episode
from roboverse_learn.data.dataset.staging import stage_episode, staged_directory
from roboverse_learn.data.dataset.video import EncoderConfig


class EpisodeSource(Protocol):
    """Runs episodes of a pool."""

    def attempts(self, indices: Iterator[int]) -> Iterator[tuple[int, EpisodeData | None]]:
        """Runs the episodes that ``indices`` names, in any order, several at once if it likes.

        An iterator that ends means "no more for now": finish what is running and return. The method may
        be called again.

        Args:
            indices: Pool indices; taking one promises to yield it.

        Yields:
            Each pool index with its episode, or with None where the expert failed. The episode's
            ``metadata["episode"]`` is the pool index.
        """
        ...

    def close(self) -> None:
        """Releases the simulator."""
        ...


def make_source(reference: str, kwargs: Mapping[str, Any]) -> EpisodeSource:
    """Calls the function that a ``"package.module:function"`` reference names.

    Args:
        reference: Importable in a fresh process.
        kwargs: JSON-able arguments of the function.

    Raises:
        DatasetError: There is no such function.
    """
    module, _, name = reference.partition(":")
    try:
        factory = getattr(importlib.import_module(module), name)
    except (ImportError, AttributeError, ValueError) as error:
        message = f"No episode source '{reference}': {error}. Give 'package.module:function'."
        raise DatasetError(message) from error
    return factory(**kwargs)


def run_attempts(source: EpisodeSource, indices: Iterator[int]) -> Iterator[tuple[int, EpisodeData | None]]:
    """Yields what a source makes of the indices, and holds it to its promise.

    Raises:
        DatasetError: The source yields an index that it did not take, or keeps one that it took.
    """
    taken: set[int] = set()

    def taking() -> Iterator[int]:
        for index in indices:
            taken.add(index)
            yield index

    for index, episode in source.attempts(taking()):
        if index not in taken:
            raise DatasetError(f"The source yielded pool episode {index}, which it was not asked for.")
        taken.discard(index)
        yield index, episode
    if taken:
        raise DatasetError(f"The source took the pool episodes {sorted(taken)} and never yielded them.")


def stage_attempt(
    root: Path,
    index: int,
    episode: EpisodeData | None,
    *,
    features: Mapping[str, Feature],
    fps: int,
    encoder: EncoderConfig,
) -> Path | None:
    """Checks and stages one attempt of a source.

    Returns:
        The staged folder, or None for a failed attempt.

    Raises:
        DatasetError: The episode does not fit the dataset, or the disk is full.
    """
    if episode is None:
        return None
    if episode.metadata.get("episode") != index:
        raise DatasetError(
            f"The source yielded pool episode {index} with metadata['episode'] = "
            f"{episode.metadata.get('episode')!r}. They must be the same."
        )
    check_episode(episode, features)
    return stage_episode(staged_directory(root, index), episode, fps, encoder).directory
