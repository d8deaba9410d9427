"""Metadata of a dataset, read without LeRobot and without torch."""

import json
from dataclasses import dataclass
from functools import cached_property
from pathlib import Path
from typing import Any

import numpy as np

from envs.core.errors import DatasetError, suggest
from roboverse_learn.data.dataset import stats as statistics
from roboverse_learn.data.dataset.damage import broken_file, read_json
from roboverse_learn.data.dataset.schema import (
    CODEBASE_VERSION,
    COLLECTION_PATH,
    DATA_PATH,
    INFO_PATH,
    RAW_PATH,
    STATS_PATH,
    TASKS_PATH,
    VIDEO_PATH,
    Feature,
)
from roboverse_learn.data.dataset.tables import read_parquet, to_numpy

METADATA_COLUMN = "roboverse/metadata"
_EPISODE_COLUMNS = ["episode_index", "tasks", "length", "dataset_from_index", "dataset_to_index"]


@dataclass(frozen=True, kw_only=True)
class DatasetInfo:
    """The metadata of a LeRobotDataset v3, of any writer.

    Attributes:
        root: The dataset's folder.
        fps: Frames per second.
        robot_type: Name of the robot, or None.
        features: LeRobot's feature descriptions by key, the bookkeeping columns included.
        num_episodes: Episodes committed.
        num_frames: Frames of all of them.
        stats: Statistics by feature key and name; images (3, 1, 1) in 0..1.
        tasks: Instructions; ``task_index`` counts into this list.
        episodes: One dict per episode: LeRobot's columns without the statistics.
    """

    root: Path
    fps: int
    robot_type: str | None
    features: dict[str, Feature]
    num_episodes: int
    num_frames: int
    stats: statistics.Stats
    tasks: tuple[str, ...]
    episodes: tuple[dict[str, Any], ...]

    @classmethod
    def open(cls, root: str | Path) -> "DatasetInfo":
        """Reads a dataset's metadata.

        Args:
            root: Folder with ``meta/info.json``.

        Raises:
            DatasetError: There is no dataset, it is empty, of another version, or a file is damaged.
        """
        root = Path(root)
        info = read_info(root)
        if info["total_episodes"] == 0:
            raise DatasetError(f"The dataset '{root}' has no episode yet. Collect some first.")
        episodes = read_episodes(root)[: info["total_episodes"]]
        if len(episodes) < info["total_episodes"]:
            raise broken_file(
                root / "meta" / "episodes", f"{len(episodes)} of {info['total_episodes']} episodes are listed"
            )
        if (needed := episodes[-1]["dataset_to_index"]) > info["total_frames"]:
            reason = f"total_frames is {info['total_frames']}, and the episodes have {needed} frames"
            raise broken_file(root / INFO_PATH, reason)
        return cls(
            root=root,
            fps=info["fps"],
            robot_type=info.get("robot_type"),
            features=info["features"],
            num_episodes=info["total_episodes"],
            num_frames=info["total_frames"],
            stats=read_stats(root / STATS_PATH),
            tasks=tuple(read_tasks(root)),
            episodes=tuple(episodes),
        )

    @property
    def shapes(self) -> dict[str, tuple[int, ...]]:
        """Shape of one frame of each feature; images (H, W, 3)."""
        return {key: tuple(feature["shape"]) for key, feature in self.features.items()}

    @property
    def camera_keys(self) -> tuple[str, ...]:
        """Keys of every image feature, stored as video or as images."""
        return tuple(k for k, feature in self.features.items() if feature["dtype"] in ("video", "image"))

    @cached_property
    def episode_starts(self) -> np.ndarray:
        """First frame of each episode, int64 (num_episodes,)."""
        return np.array([episode["dataset_from_index"] for episode in self.episodes], dtype=np.int64)

    @cached_property
    def episode_ends(self) -> np.ndarray:
        """One past the last frame of each episode, int64 (num_episodes,)."""
        return np.array([episode["dataset_to_index"] for episode in self.episodes], dtype=np.int64)

    @property
    def episode_lengths(self) -> np.ndarray:
        """Frames of each episode, int64 (num_episodes,)."""
        return self.episode_ends - self.episode_starts

    @cached_property
    def episode_metadata(self) -> tuple[dict[str, Any], ...]:
        """:attr:`EpisodeData.metadata` of each episode; empty where another tool wrote it."""
        return tuple(json.loads(episode.get(METADATA_COLUMN) or "{}") for episode in self.episodes)

    @property
    def named_tasks(self) -> list[str]:
        """Names of the tasks that the episodes are of; empty where another tool wrote them."""
        return sorted({str(each["task"]) for each in self.episode_metadata if "task" in each})

    def data_files(self) -> list[Path]:
        """Returns the files of the numeric columns, in the order of the frames."""
        numbers = dict.fromkeys((e["data/chunk_index"], e["data/file_index"]) for e in self.episodes)
        return [self.root / DATA_PATH.format(chunk_index=c, file_index=f) for c, f in numbers]

    def video_file(self, episode: int, key: str) -> Path:
        """Returns the video that holds an episode of a camera."""
        row = self.episodes[episode]
        chunk, file = row[f"videos/{key}/chunk_index"], row[f"videos/{key}/file_index"]
        return self.root / VIDEO_PATH.format(video_key=key, chunk_index=chunk, file_index=file)

    def raw_file(self, episode: int) -> Path:
        """Returns the file of an episode's simulator states."""
        return self.root / RAW_PATH.format(episode_index=episode)

    def read_columns(self, keys: list[str] | None = None) -> dict[str, np.ndarray]:
        """Reads numeric columns of all frames, in order.

        Args:
            keys: Which; all numeric ones by default.

        Returns:
            (num_frames,) or (num_frames, *shape) arrays by key.

        Raises:
            DatasetError: A file is absent, truncated, or has too few rows.
        """
        if keys is None:
            keys = [k for k, f in self.features.items() if f["dtype"] not in ("video", "image", "string")]
        parts: dict[str, list[np.ndarray]] = {key: [] for key in keys}
        for path in self.data_files():
            table = read_parquet(path, keys)
            for key in keys:
                parts[key].append(to_numpy(table[key], self.features[key]))
        columns = {key: np.concatenate(arrays)[: self.num_frames] for key, arrays in parts.items()}
        for key, values in columns.items():
            if len(values) < self.num_frames:
                reason = f"'{key}' has {len(values)} of {self.num_frames} frames"
                raise broken_file(self.root / "data", reason)
        return columns


def is_collected_here(root: Path) -> bool:
    """Whether a dataset is of a collection of ours, with its settings, and neither merged nor edited."""
    return (root / COLLECTION_PATH).is_file()


def read_info(root: Path) -> dict[str, Any]:
    """Reads ``meta/info.json``.

    Raises:
        DatasetError: There is no dataset here, or it has another version.
    """
    if not (root / INFO_PATH).exists():
        raise DatasetError(_no_dataset(root))
    info = read_json(root / INFO_PATH)
    if not isinstance(info, dict) or not {"fps", "features", "total_episodes", "total_frames"} <= set(info):
        raise broken_file(root / INFO_PATH, "it does not describe a dataset")
    version = str(info.get("codebase_version"))
    if not version.startswith("v3."):
        way_out = (
            "Convert it with LeRobot's convert_dataset_v21_to_v30."
            if version.startswith("v2.")
            else f"Name a dataset of {CODEBASE_VERSION}, or write this one again with a LeRobot of it."
        )
        raise DatasetError(
            f"The dataset '{root}' has the version {version}; valid is {CODEBASE_VERSION}. {way_out}"
        )
    if wrong := _wrong_value(info):
        raise broken_file(root / INFO_PATH, wrong)
    return info


def _wrong_value(info: dict[str, Any]) -> str:
    """Says which value of ``meta/info.json`` no dataset has; empty where each is possible."""
    if not _is_number(info["fps"]) or info["fps"] <= 0:
        return f"fps must be a number above 0, given {info['fps']!r}"
    for key in ("total_episodes", "total_frames"):
        if not isinstance(info[key], int) or info[key] < 0:
            return f"{key} must be a whole number, 0 or more, given {info[key]!r}"
    features = info["features"]
    if not isinstance(features, dict) or not features:
        return "features must name at least one feature"
    for key, feature in features.items():
        if not isinstance(feature, dict) or not {"dtype", "shape"} <= set(feature):
            return f"the feature {key} has no dtype or no shape"
    return ""


def _is_number(value: Any) -> bool:
    return isinstance(value, int | float) and not isinstance(value, bool)


def read_stats(path: Path) -> statistics.Stats:
    """Reads ``meta/stats.json``; a dataset may have none.

    Raises:
        DatasetError: It does not hold statistics.
    """
    if not path.exists():
        return {}
    value = read_json(path)
    try:
        return statistics.from_json(value)
    except (AttributeError, TypeError, ValueError) as error:
        raise broken_file(path, "it does not hold statistics by feature") from error


def datasets_in(*folders: Path) -> list[str]:
    """Returns the datasets that lie in folders, not deeper."""
    return [str(path.parents[1]) for folder in folders for path in folder.glob(f"*/{INFO_PATH}")]


def _no_dataset(root: Path) -> str:
    """Returns the message for a path at which there is no dataset."""
    if root.is_file():
        return f"'{root}' is a file, and a dataset is a folder that holds {INFO_PATH}. Name that folder."
    near = suggest(str(root), datasets_in(root, root.parent))
    return (
        f"There is no dataset in '{root}' ({INFO_PATH} is missing).{near} "
        "Collect one there first, or name another folder."
    )


def read_tasks(root: Path) -> list[str]:
    """Reads the instructions in the order of ``task_index``."""
    table = read_parquet(root / TASKS_PATH)
    names = next(name for name in table.column_names if name != "task_index")
    pairs = zip(table["task_index"].to_pylist(), table[names].to_pylist(), strict=True)
    return [task for _, task in sorted(pairs)]


def read_episodes(root: Path, *, with_stats: bool = False) -> list[dict[str, Any]]:
    """Reads the rows of ``meta/episodes`` in the order of the episodes."""
    rows: list[dict[str, Any]] = []
    for path in sorted((root / "meta" / "episodes").glob("*/*.parquet")):
        table = read_parquet(path)
        kept = [name for name in table.column_names if with_stats or not name.startswith("stats/")]
        missing = sorted(set(_EPISODE_COLUMNS) - set(kept))
        if missing:
            raise broken_file(path, f"it lacks the columns {missing}")
        rows.extend(table.select(kept).to_pylist())
    return rows


_IDENTITY = (
    *("task", "task_kwargs", "robot", "scenario", "simulator", "simulator_settings", "renderer"),
    *("level", "channels", "steps_per_look", "split", "protocol_seed", "episode", "source_episode"),
    *("source", "policy", "weights", "sources", "file_sha256", "demonstration"),
)
"""Metadata in which episodes of one pool index differ: their environment, and who demonstrated."""


def episode_key(metadata: dict[str, Any]) -> str | None:
    """Returns the key that identifies a pool episode, or None for an episode of no pool."""
    if "episode" not in metadata:
        return None
    own = {name: metadata[name] for name in _IDENTITY if metadata.get(name) not in (None, "", {})}
    if own.get("source") == "rerender":  # its first look is the recorded episode itself
        del own["source"]
    return json.dumps(own, sort_keys=True)
