"""An episode's raw simulator states, and the fingerprint of a whole dataset."""

import hashlib
import json
from pathlib import Path
from typing import Any

import numpy as np

from envs.core.errors import DatasetError
from roboverse_learn.data.dataset.info import DatasetInfo
from roboverse_learn.data.dataset.schema import RAW_PATH, video_keys
from roboverse_learn.data.dataset.staging import read_header, read_tensors
from roboverse_learn.data.dataset.tables import read_parquet
from roboverse_learn.data.dataset.video import check_there

# When and how fast something was collected is no part of what was collected.
VOLATILE_METADATA = frozenset({"created", "timestamp", "wall_time_s", "hostname", "worker"})


def read_raw(root: str | Path, episode: int) -> tuple[dict[str, np.ndarray], dict[str, Any]]:
    """Reads what replays an episode.

    Args:
        root: The dataset's folder.
        episode: Index of the episode in the dataset.

    Returns:
        The arrays and the metadata given in :class:`~roboverse_learn.data.dataset.schema.EpisodeData`.

    Raises:
        DatasetError: The dataset has no such episode or no raw states, or the file is damaged.
    """
    return read_tensors(_raw_file(root, episode))


def check_raw(root: str | Path, episode: int) -> None:
    """Checks that an episode's raw states are there and whole, without reading them.

    Raises:
        DatasetError: as :func:`read_raw`.
    """
    read_header(_raw_file(root, episode))


def has_raw(info: DatasetInfo) -> bool:
    """Whether any episode of a dataset has raw states; none of another program's has."""
    return any(info.raw_file(index).exists() for index in range(info.num_episodes))


def check_all_raw(info: DatasetInfo) -> None:
    """Checks that the raw states of every episode are there and whole, without reading them.

    Raises:
        DatasetError: A file is missing or truncated; it names the first.
    """
    for path in map(info.raw_file, range(info.num_episodes)):
        if not path.exists():
            others = "and other episodes have theirs" if has_raw(info) else "as is that of every episode"
            raise DatasetError(
                f"'{path}' is missing, {others}. Restore it from a copy, or delete the dataset's folder and "
                "collect it again."
            )
        read_header(path)


def _raw_file(root: str | Path, episode: int) -> Path:
    path = Path(root) / RAW_PATH.format(episode_index=episode)
    if not path.exists():
        count = DatasetInfo.open(root).num_episodes
        raise DatasetError(
            f"The dataset '{root}' has no raw states of episode {episode} ('{path.name}' is missing). It has "
            f"{count} episodes, 0 to {count - 1}; datasets of other programs hold no raw states."
        )
    return path


def dataset_hash(root: str | Path) -> str:
    """Returns a sha256 over what a dataset holds: numbers, raw states, metadata, images and video files.

    It does not depend on the number of collecting processes, on dates, or on how tables are spread over
    files.

    Args:
        root: The dataset's folder.

    Returns:
        64 hexadecimal digits.
    """
    info = DatasetInfo.open(root)
    digest = hashlib.sha256()
    for key, values in sorted(info.read_columns().items()):
        _update(digest, key, values)
    digest.update(json.dumps([list(info.tasks), info.fps]).encode())
    raw = has_raw(info)
    if raw:
        check_all_raw(info)
    for index in range(info.num_episodes) if raw else ():
        arrays, metadata = read_raw(root, index)
        kept = {name: value for name, value in metadata.items() if name not in VOLATILE_METADATA}
        digest.update(json.dumps(kept, sort_keys=True).encode())
        for name, values in sorted(arrays.items()):
            _update(digest, name, values)
    _update_images(digest, info)
    for key in video_keys(info.features):
        files = dict.fromkeys(info.video_file(index, key) for index in range(info.num_episodes))
        for path in files:
            check_there(path)
            digest.update(path.read_bytes())
    return digest.hexdigest()


def _update_images(digest: Any, info: DatasetInfo) -> None:
    """Adds the images that tables hold, as those of some other programs do."""
    for key in (key for key, feature in info.features.items() if feature["dtype"] == "image"):
        digest.update(f"{key}:image:".encode())
        for path in info.data_files():
            for image in read_parquet(path, [key])[key].to_pylist():
                digest.update(image["bytes"] or image["path"].encode())


def _update(digest: Any, name: str, values: np.ndarray) -> None:
    """Adds an array with its name, dtype and shape to a digest."""
    digest.update(f"{name}:{values.dtype.str}:{values.shape}:".encode())
    digest.update(np.ascontiguousarray(values).tobytes())
