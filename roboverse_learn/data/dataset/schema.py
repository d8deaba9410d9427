"""Schema of a dataset: the features of LeRobotDataset v3, and one episode to be written.

Shape legend: T = frames of an episode, S = state dimension, A = action dimension, H, W = image size.
"""

import json
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field
from typing import Any

import numpy as np

from envs.core.errors import DatasetError
from envs.core.observation_keys import IMAGE_PREFIX

CODEBASE_VERSION = "v3.0"
FILES_PER_CHUNK = 1000

STATE_KEY = "observation.state"
ACTION_KEY = "action"
REWARD_KEY = "next.reward"
SUCCESS_KEY = "next.success"
INTERVENTION_KEY = "intervention"
"""Whether a person acted in a step, and no policy: LeRobot's column of corrections."""

OPTIONAL_KEYS = frozenset({REWARD_KEY, SUCCESS_KEY, INTERVENTION_KEY})
"""Columns that not every dataset has."""

DATA_PATH = "data/chunk-{chunk_index:03d}/file-{file_index:03d}.parquet"
EPISODES_PATH = "meta/episodes/chunk-{chunk_index:03d}/file-{file_index:03d}.parquet"
VIDEO_PATH = "videos/{video_key}/chunk-{chunk_index:03d}/file-{file_index:03d}.mp4"
RAW_PATH = "raw/episode_{episode_index:06d}.safetensors"
INFO_PATH = "meta/info.json"
STATS_PATH = "meta/stats.json"
TASKS_PATH = "meta/tasks.parquet"
COLLECTION_PATH = "meta/collection.json"

# The columns that LeRobot adds to every dataset (lerobot.utils.constants.DEFAULT_FEATURES).
BOOKKEEPING: dict[str, str] = {
    "timestamp": "float32",
    "frame_index": "int64",
    "episode_index": "int64",
    "index": "int64",
    "task_index": "int64",
}

Feature = dict[str, Any]


@dataclass(kw_only=True, slots=True)
class EpisodeData:
    """One complete episode, as the simulator and the expert produced it.

    Row ``t`` pairs the observation before step ``t`` with the action of step ``t``.

    Attributes:
        states: Proprioception, float32 (T, S).
        actions: Joint position targets, float32 (T, A).
        images: RGB per camera name, uint8 (T, H, W, 3).
        task: The instruction in words.
        raw: What replays the episode exactly: simulator states of T + 1 rows, controls, and whatever
            else a replay needs; any shape, stored as given (floats as float64).
        metadata: JSON-able facts: task, level, channels, split, ``episode`` (index in the pool),
            simulator, renderer, seed, initial state hash, success, versions.
        rewards: Reward of step ``t``, float32 (T,); only where the dataset has ``next.reward``.
        successes: Success after step ``t``, bool (T,); only where the dataset has ``next.success``.
        interventions: Whether a person acted in step ``t``, bool (T,); only where the dataset has
            ``intervention``.
    """

    states: np.ndarray
    actions: np.ndarray
    images: Mapping[str, np.ndarray]
    task: str
    raw: dict[str, np.ndarray] = field(default_factory=dict)
    metadata: dict[str, Any] = field(default_factory=dict)
    rewards: np.ndarray | None = None
    successes: np.ndarray | None = None
    interventions: np.ndarray | None = None

    @property
    def length(self) -> int:
        """Number of frames T."""
        return len(self.actions)

    def low_dim(self) -> dict[str, np.ndarray]:
        """Returns every numeric column that this episode carries, by feature key."""
        columns = {STATE_KEY: self.states, ACTION_KEY: self.actions}
        if self.rewards is not None:
            columns[REWARD_KEY] = self.rewards
        if self.successes is not None:
            columns[SUCCESS_KEY] = self.successes
        if self.interventions is not None:
            columns[INTERVENTION_KEY] = self.interventions
        return columns


def make_features(
    state_names: Sequence[str],
    action_names: Sequence[str],
    cameras: Mapping[str, tuple[int, int]],
    *,
    reward: bool = False,
    success: bool = False,
    intervention: bool = False,
) -> dict[str, Feature]:
    """Builds the features of a LeRobotDataset v3, without LeRobot's bookkeeping columns.

    Args:
        state_names: Name of each state dimension.
        action_names: Name of each action dimension.
        cameras: Image size (H, W) by camera name.
        reward: Whether frames carry ``next.reward``.
        success: Whether frames carry ``next.success``.
        intervention: Whether frames carry ``intervention``.

    Raises:
        DatasetError: An image size is odd or not positive (4:2:0 video stores pairs of pixels).
    """
    features: dict[str, Feature] = {
        STATE_KEY: {"dtype": "float32", "shape": [len(state_names)], "names": list(state_names)},
        ACTION_KEY: {"dtype": "float32", "shape": [len(action_names)], "names": list(action_names)},
    }
    for camera, (height, width) in cameras.items():
        if height <= 0 or width <= 0 or height % 2 or width % 2:
            raise DatasetError(
                f"Camera '{camera}' has the image size {height}x{width}; video needs an even, positive "
                "height and width."
            )
        features[IMAGE_PREFIX + camera] = {
            "dtype": "video",
            "shape": [height, width, 3],
            "names": ["height", "width", "channels"],
        }
    if reward:
        features[REWARD_KEY] = {"dtype": "float32", "shape": [1], "names": None}
    if success:
        features[SUCCESS_KEY] = {"dtype": "bool", "shape": [1], "names": None}
    if intervention:
        features[INTERVENTION_KEY] = {"dtype": "bool", "shape": [1], "names": None}
    return features


def with_bookkeeping(features: Mapping[str, Feature]) -> dict[str, Feature]:
    """Adds the columns of every LeRobot dataset."""
    bookkeeping = {key: {"dtype": kind, "shape": [1], "names": None} for key, kind in BOOKKEEPING.items()}
    return {**{key: dict(feature) for key, feature in features.items()}, **bookkeeping}


def layout_difference(first: Mapping[str, Feature], other: Mapping[str, Feature]) -> str:
    """Returns the first difference of two datasets' columns in words; empty if they hold the same ones.

    How their videos were encoded does not matter.
    """
    for key in (key for key in {**first, **other} if key not in BOOKKEEPING):
        one, another = first.get(key), other.get(key)
        if one is None or another is None:
            return f"{key} in the {'second' if one is None else 'first'} alone"
        if tuple(one["shape"]) != tuple(another["shape"]):
            return f"{key} of shape {tuple(one['shape'])} and {tuple(another['shape'])}"
        if _kind(one) != _kind(another):
            return f"{key} of {_kind(one)} and {_kind(another)}"
    return ""


def _kind(feature: Feature) -> str:
    names = feature.get("names")
    return f"{feature['dtype']} {json.dumps(names)}" if names else str(feature["dtype"])


def video_keys(features: Mapping[str, Feature]) -> list[str]:
    """Returns the keys of the features stored as video, in the dataset's order."""
    return [key for key, feature in features.items() if feature["dtype"] == "video"]


def chunk_and_file(number: int) -> tuple[int, int]:
    """Returns (chunk index, file index) of the ``number``-th file."""
    return divmod(number, FILES_PER_CHUNK)


def check_episode(episode: EpisodeData, features: Mapping[str, Feature]) -> None:
    """Checks that an episode is what the dataset's features say.

    Raises:
        DatasetError: A column is missing, superfluous, of another shape or dtype, or not finite; or the
            metadata is not JSON.
    """
    given = {**episode.low_dim(), **{IMAGE_PREFIX + name: v for name, v in episode.images.items()}}
    if set(given) != set(features):
        missing = sorted(set(features) - set(given))
        extra = sorted(set(given) - set(features))
        raise DatasetError(
            f"The episode does not fit the dataset: missing {missing or 'nothing'}, unknown "
            f"{extra or 'nothing'}. The dataset's features are {sorted(features)}."
        )
    if episode.length == 0:
        raise DatasetError("The episode has no frames. Give at least one.")
    for key, feature in features.items():
        _check_column(key, given[key], feature, episode.length)
    try:
        json.dumps(episode.metadata, allow_nan=False)
    except (TypeError, ValueError) as error:
        raise DatasetError(f"The episode's metadata is not JSON: {error}.") from error


def _check_column(key: str, values: np.ndarray, feature: Feature, length: int) -> None:
    """Checks shape, dtype and finiteness of one column."""
    shape = tuple(feature["shape"])
    expected = (length,) if shape == (1,) else (length, *shape)
    if values.shape != expected and values.shape != (length, *shape):
        raise DatasetError(f"'{key}' has the shape {values.shape}; the dataset needs {expected}.")
    if feature["dtype"] == "video":
        if values.dtype != np.uint8:
            raise DatasetError(f"'{key}' has the dtype {values.dtype}; images are uint8, 0 to 255.")
    elif not np.isfinite(values).all():
        row = int(np.argwhere(~np.isfinite(values))[0][0])
        raise DatasetError(f"'{key}' is not finite at frame {row}; the simulation has diverged.")
