"""Recorded episodes of a dataset: states, actions and where they come from."""

from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np
import torch

from envs.core.errors import DatasetError
from envs.state import State
from roboverse_learn.data.dataset.info import DatasetInfo
from roboverse_learn.data.dataset.raw import read_raw
from roboverse_learn.data.dataset.schema import ACTION_KEY

_NEEDED = ("task", "episode", "split", "simulator")


@dataclass(frozen=True, slots=True)
class Recording:
    """One recorded episode of T control steps.

    Attributes:
        index: Its index in the dataset.
        states: States before each step and after the last: T + 1 rows.
        actions: Actions of the task's controller, (T, A) float32.
        metadata: Metadata of the dataset; see :class:`~roboverse_learn.data.dataset.schema.EpisodeData`.
    """

    index: int
    states: State
    actions: np.ndarray
    metadata: dict[str, Any]

    @property
    def num_steps(self) -> int:
        """T."""
        return len(self.actions)


def read_recordings(root: str | Path, count: int = 0) -> list[Recording]:
    """Reads the first ``count`` episodes of a dataset, or all of them for 0.

    Raises:
        DatasetError: There is no dataset, it holds no raw states, or does not say where they come from.
    """
    reader = RecordingReader(root)
    return [reader.read(index) for index in range(min(count or len(reader), len(reader)))]


class RecordingReader:
    """Reads recorded episodes of a dataset one by one.

    Args:
        root: The dataset's folder.

    Raises:
        DatasetError: There is no dataset.
    """

    def __init__(self, root: str | Path) -> None:
        self.info = DatasetInfo.open(root)
        self._actions = self.info.read_columns([ACTION_KEY])[ACTION_KEY]

    def __len__(self) -> int:
        return self.info.num_episodes

    def read(self, index: int) -> Recording:
        """Returns an episode by its index in the dataset.

        Raises:
            DatasetError: It has no raw states, or does not say where they come from.
        """
        arrays, metadata = read_raw(self.info.root, index)
        missing = [key for key in _NEEDED if key not in metadata]
        if missing:
            raise DatasetError(
                f"Episode {index} of '{self.info.root}' does not say its {', '.join(missing)}, so it cannot "
                "be replayed. Collect it again with: roboverse collect"
            )
        start, end = self.info.episode_starts[index], self.info.episode_ends[index]
        flat = {key: torch.from_numpy(value) for key, value in arrays.items()}
        return Recording(index, State.unflatten(flat), self._actions[start:end], metadata)
