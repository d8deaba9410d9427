"""Puts the episodes of several datasets into one, without decoding or encoding anything."""

import logging
import shutil
from collections.abc import Sequence
from pathlib import Path

from envs.core.atomic import atomic_directory, link_file, write_errors
from envs.core.errors import DatasetError
from roboverse_learn.data.dataset.info import METADATA_COLUMN, DatasetInfo, episode_key, read_episodes
from roboverse_learn.data.dataset.meta_tables import row_stats
from roboverse_learn.data.dataset.raw import check_raw
from roboverse_learn.data.dataset.schema import (
    BOOKKEEPING,
    COLLECTION_PATH,
    OPTIONAL_KEYS,
    Feature,
    layout_difference,
    video_keys,
)
from roboverse_learn.data.dataset.staging import StagedEpisode
from roboverse_learn.data.dataset.video import check_video
from roboverse_learn.data.dataset.writer import DatasetWriter

_LOG = logging.getLogger(__name__)


def merge(sources: Sequence[str | Path], root: str | Path) -> DatasetInfo:
    """Appends every episode of the sources that ``root`` does not hold yet, ordered by pool episode.

    Videos and raw states get a second name (a hard link, or a copy across file systems); numbers are
    rewritten with new indices. The result depends on the sources' episodes only, not on how they were
    spread over the sources. A killed merge is completed by the same call. A dataset that episodes are added
    to is of no collection any more.

    Args:
        sources: Folders of datasets written by :class:`DatasetWriter`, with the same features. Of the columns
            that not every dataset has (``OPTIONAL_KEYS``), those that are in all sources are kept.
        root: Where the merged dataset is; it may exist.

    Returns:
        The merged dataset.

    Raises:
        DatasetError: A source is damaged, has other features, or was written by another program.
    """
    infos = [DatasetInfo.open(source) for source in sources]
    if not infos:
        raise DatasetError("Nothing to merge. Give at least one dataset.")
    for info in infos:
        _check_source(info, infos[0])
    for info in infos:
        _check_files(info)
    order = sorted(
        (
            (_order(info, index), source, index)
            for source, info in enumerate(infos)
            for index in _indices(info)
        ),
    )
    rows = [read_episodes(info.root, with_stats=True) for info in infos]
    columns = [info.read_columns() for info in infos]
    features = {key: f for key, f in infos[0].features.items() if _is_in_all(key, infos)}
    with DatasetWriter(root, fps=infos[0].fps, features=features, robot_type=infos[0].robot_type) as writer:
        for _, source, index in order:
            info = infos[source]
            if episode_key(info.episode_metadata[index]) in writer.episode_keys:
                continue
            staged = _stage_links(writer.staging_directory / "merge", info, index)
            part = slice(info.episode_starts[index], info.episode_ends[index])
            numbers = {k: v[part] for k, v in columns[source].items() if k in features}
            images = {key: row_stats(rows[source][index])[key] for key in video_keys(info.features)}
            metadata, task = info.episode_metadata[index], info.episodes[index]["tasks"][0]
            # Before the commit: no kill leaves a collection's record beside episodes of others.
            with write_errors(writer.root):
                (writer.root / COLLECTION_PATH).unlink(missing_ok=True)
            writer.commit(
                StagedEpisode(
                    directory=staged, columns=numbers, task=task, metadata=metadata, image_stats=images
                )
            )
    return DatasetInfo.open(root)


def _indices(info: DatasetInfo) -> range:
    return range(info.num_episodes)


def _order(info: DatasetInfo, index: int) -> tuple[str, str, str, int, str]:
    """Returns what merged episodes are sorted by."""
    metadata = info.episode_metadata[index]
    task, level, split = (str(metadata.get(name, "")) for name in ("task", "level", "split"))
    return task, level, split, int(metadata["episode"]), str(episode_key(metadata))


def _is_in_all(key: str, infos: Sequence[DatasetInfo]) -> bool:
    """Whether a column, which is none of LeRobot's bookkeeping, is in every dataset."""
    return key not in BOOKKEEPING and all(key in info.features for info in infos)


def _required(info: DatasetInfo) -> dict[str, Feature]:
    return {key: feature for key, feature in info.features.items() if key not in OPTIONAL_KEYS}


def _check_source(info: DatasetInfo, first: DatasetInfo) -> None:
    """Checks that a source can be merged with the first one."""
    if METADATA_COLUMN not in info.episodes[0]:
        raise DatasetError(
            f"The dataset '{info.root}' was written by another program. Merge it with LeRobot's "
            "aggregate_datasets."
        )
    if not all("episode" in metadata for metadata in info.episode_metadata):
        raise DatasetError(
            f"The dataset '{info.root}' holds episodes without a pool index (metadata 'episode'), so their "
            "order is undefined. Merge it with LeRobot's aggregate_datasets."
        )
    if difference := _difference(first, info):
        raise DatasetError(
            f"The datasets '{first.root}' and '{info.root}' have {difference}. Merge only datasets of the "
            "same robot, cameras and image size."
        )


def _difference(first: DatasetInfo, info: DatasetInfo) -> str:
    """Returns what keeps two datasets from being one, in words; empty where nothing does."""
    if info.fps != first.fps:
        return f"{first.fps} and {info.fps} fps"
    return layout_difference(_required(first), _required(info))


def _check_files(info: DatasetInfo) -> None:
    """Checks that the videos and raw states of a source are whole, before any of them gets a second name."""
    for index, length in enumerate(info.episode_lengths):
        check_raw(info.root, index)
        for key in video_keys(info.features):
            check_video(info.video_file(index, key), int(length))


def _stage_links(directory: Path, info: DatasetInfo, index: int) -> Path:
    """Gives an episode's videos and raw states their staged names."""
    shutil.rmtree(directory, ignore_errors=True)
    with write_errors(directory):
        directory.mkdir(parents=True)
    for key in video_keys(info.features):
        link_file(info.video_file(index, key), directory / f"{key}.mp4")
    link_file(info.raw_file(index), directory / "raw.safetensors")
    return directory


def consolidate(root: str | Path, destination: str | Path) -> DatasetInfo:
    """Copies a dataset with many episodes per video file, as the Hub prefers it; streams are not re-encoded.

    The copy is for publishing and reading; only the original can be continued.

    Args:
        root: A dataset of any writer.
        destination: A folder that does not exist yet; it appears when it is complete.

    Raises:
        DatasetError: The destination exists, or the source is damaged.
    """
    from lerobot.datasets import aggregate_datasets

    info, destination = DatasetInfo.open(root), Path(destination)
    if destination.exists():
        raise DatasetError(f"'{destination}' exists already. Delete it or choose another folder.")
    with atomic_directory(destination) as staging:
        staging.rmdir()  # LeRobot creates it
        aggregate_datasets(["roboverse/source"], "roboverse/merged", roots=[info.root], aggr_root=staging)
        for index in _indices(info):
            if info.raw_file(index).exists():
                link_file(info.raw_file(index), staging / info.raw_file(index).relative_to(info.root))
    return DatasetInfo.open(destination)
