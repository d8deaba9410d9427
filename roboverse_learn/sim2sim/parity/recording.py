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
    info = DatasetInfo.open(root)
    actions = info.read_columns([ACTION_KEY])[ACTION_KEY]
    recordings = []
    for index in range(min(count or info.num_episodes, info.num_episodes)):
        arrays, metadata = read_raw(root, index)
        missing = [key for key in _NEEDED if key not in metadata]
        if missing:
            raise DatasetError(
                f"Episode {index} of '{root}' does not say its {', '.join(missing)}, so it cannot be "
                "replayed. Collect it again with: roboverse collect"
            )
        start, end = info.episode_starts[index], info.episode_ends[index]
        flat = {key: torch.from_numpy(value) for key, value in arrays.items()}
        recordings.append(Recording(index, State.unflatten(flat), actions[start:end], metadata))
    return recordings
