"""Finished episodes on disk that no dataset lists yet.

A worker turns an episode into a folder of ready files (videos, numbers, raw states) and renames it into
place, so a staged episode is whole or absent. Committing it only adds names and a row of metadata; any
process can do that, at any later time.
"""

import contextlib
import json
import os
import shutil
from collections.abc import Iterator
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np

from envs.core.atomic import partial_path, write_errors, write_file
from envs.core.errors import DatasetError
from envs.core.observation_keys import IMAGE_PREFIX
from roboverse_learn.data.dataset.damage import broken_file
from roboverse_learn.data.dataset.schema import EpisodeData
from roboverse_learn.data.dataset.stats import FeatureStats, from_json, image_stats, to_json
from roboverse_learn.data.dataset.video import EncoderConfig, encode_video

STAGING_DIRECTORY = ".staging"

_NUMBERS_FILE = "numbers.safetensors"
_RAW_FILE = "raw.safetensors"
_HEADER_KEY = "roboverse"


@dataclass(frozen=True, kw_only=True)
class StagedEpisode:
    """An episode whose files are ready.

    Attributes:
        directory: Its folder; committing or discarding removes it.
        columns: Numeric columns by feature key, (T,) or (T, D).
        task: The instruction.
        metadata: As given in :class:`EpisodeData`.
        image_stats: Statistics per video key.
    """

    directory: Path
    columns: dict[str, np.ndarray]
    task: str
    metadata: dict[str, Any]
    image_stats: dict[str, FeatureStats]

    @property
    def length(self) -> int:
        """Number of frames."""
        return len(next(iter(self.columns.values())))

    @property
    def raw_file(self) -> Path:
        """The raw simulator states."""
        return self.directory / _RAW_FILE

    def video_file(self, key: str) -> Path:
        """The video of one camera."""
        return self.directory / f"{key}.mp4"

    def discard(self) -> None:
        """Removes the staged files."""
        shutil.rmtree(self.directory, ignore_errors=True)


def staged_directory(root: Path, index: int) -> Path:
    """Returns where the episode of a pool index waits to be committed."""
    return root / STAGING_DIRECTORY / f"pool_{index:06d}"


def stage_episode(directory: Path, episode: EpisodeData, fps: int, encoder: EncoderConfig) -> StagedEpisode:
    """Writes every file of an episode into a folder of its own, all of them or none.

    Args:
        directory: The folder to create; if it exists, the same episode was staged before and is kept.
        episode: A checked episode.
        fps: Frames per second.
        encoder: Video settings.

    Raises:
        DatasetError: The disk is full, or the encoder lost a frame.
    """
    partial = partial_path(directory)
    try:
        with write_errors(directory):
            partial.mkdir(parents=True)
        _write_episode(partial, episode, fps, encoder)
        with write_errors(directory):
            if not directory.exists():
                os.rename(partial, directory)
    finally:
        shutil.rmtree(partial, ignore_errors=True)
    return load_staged(directory)


def _write_episode(directory: Path, episode: EpisodeData, fps: int, encoder: EncoderConfig) -> None:
    """Writes the files of one episode; several cameras are encoded side by side."""
    from concurrent.futures import ThreadPoolExecutor

    def write_camera(item: tuple[str, np.ndarray]) -> tuple[str, FeatureStats]:
        key, images = IMAGE_PREFIX + item[0], item[1]
        write_file(directory / f"{key}.mp4", encode_video(images, fps, encoder))
        return key, image_stats(images)

    if len(episode.images) > 1:
        with ThreadPoolExecutor(len(episode.images)) as pool:
            stats = dict(pool.map(write_camera, episode.images.items()))
    else:
        stats = dict(map(write_camera, episode.images.items()))
    write_tensors(directory / _RAW_FILE, _raw_arrays(episode.raw), episode.metadata)
    header = {"task": episode.task, "metadata": episode.metadata, "image_stats": to_json(stats)}
    write_tensors(directory / _NUMBERS_FILE, episode.low_dim(), header)


def _raw_arrays(raw: dict[str, np.ndarray]) -> dict[str, np.ndarray]:
    """Widens floats to float64, so that a replay starts from exactly what the simulator had."""
    wide = {}
    for name, values in raw.items():
        array = np.asarray(values)
        wide[name] = array.astype(np.float64) if np.issubdtype(array.dtype, np.floating) else array
    return wide


def load_staged(directory: Path) -> StagedEpisode:
    """Opens a staged episode.

    Raises:
        DatasetError: A file is absent or damaged.
    """
    columns, header = read_tensors(directory / _NUMBERS_FILE)
    return StagedEpisode(
        directory=directory,
        columns=columns,
        task=header["task"],
        metadata=header["metadata"],
        image_stats=from_json(header["image_stats"]),
    )


def write_tensors(path: Path, arrays: dict[str, np.ndarray], header: dict[str, Any]) -> None:
    """Writes arrays and a JSON header as one safetensors file."""
    from safetensors.numpy import save

    contiguous = {name: np.ascontiguousarray(array) for name, array in arrays.items()}
    write_file(path, save(contiguous, {_HEADER_KEY: json.dumps(header, sort_keys=True)}))


def read_tensors(path: Path) -> tuple[dict[str, np.ndarray], dict[str, Any]]:
    """Reads what :func:`write_tensors` wrote.

    Raises:
        DatasetError: The file is absent or damaged.
    """
    with _opened(path) as file:
        return {name: file.get_tensor(name) for name in file.keys()}, _header(file)  # noqa: SIM118


def read_header(path: Path) -> dict[str, Any]:
    """Reads the metadata of what :func:`write_tensors` wrote, and checks that the file is as long as it says.

    Raises:
        DatasetError: The file is absent or damaged.
    """
    with _opened(path) as file:
        return _header(file)


@contextlib.contextmanager
def _opened(path: Path) -> Iterator[Any]:
    from safetensors import SafetensorError, safe_open

    if not path.exists():
        raise DatasetError(f"'{path}' is missing. Restore it from a copy, or collect again.")
    try:
        with safe_open(path, framework="numpy") as file:
            yield file
    except (SafetensorError, OSError, ValueError) as error:
        raise broken_file(path, str(error)) from error


def _header(file: Any) -> dict[str, Any]:
    return json.loads((file.metadata() or {}).get(_HEADER_KEY, "{}"))
