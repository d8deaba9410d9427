"""Where demonstrations come from."""

import importlib
from collections.abc import Iterator, Mapping, Sequence
from typing import Any, Protocol

from envs.core.errors import DatasetError
from roboverse_learn.data.dataset.schema import EpisodeData


class EpisodeSource(Protocol):
    """Runs episodes of a pool, in the processes of a collection."""

    def attempts(self, indices: Sequence[int]) -> Iterator[tuple[int, EpisodeData | None]]:
        """Runs a batch of pool episodes.

        Yields:
            Each pool index once, in any order, with its episode, or with None where the demonstrator
            failed. The episode's ``metadata["episode"]`` is the pool index.
        """
        ...

    def close(self) -> None:
        """Releases the simulator."""
        ...


def load_source(reference: str, kwargs: Mapping[str, Any]) -> EpisodeSource:
    """Calls the class or function that a ``"package.module:name"`` reference names.

    Args:
        reference: Importable in a fresh process.
        kwargs: JSON-able arguments.

    Raises:
        DatasetError: There is no such class or function.
    """
    module, _, name = reference.partition(":")
    try:
        factory = getattr(importlib.import_module(module), name)
    except (ImportError, AttributeError, ValueError) as error:
        raise DatasetError(
            f"No episode source '{reference}': {error}. Give 'package.module:Class'."
        ) from error
    return factory(**kwargs)
