"""Puts a dataset right after its writer was killed.

The rows of ``meta/episodes`` are the truth: an episode with a row is complete, everything else that
bears a higher number is a leftover.
"""

import logging
import os
import re
from pathlib import Path
from typing import Any

from envs.core.atomic import remove_partial_files, write_file, write_json
from envs.core.errors import DatasetError
from roboverse_learn.data.dataset.damage import broken_file
from roboverse_learn.data.dataset.info import (
    METADATA_COLUMN,
    DatasetInfo,
    read_episodes,
    read_info,
    read_stats,
)
from roboverse_learn.data.dataset.meta_tables import combined_stats
from roboverse_learn.data.dataset.schema import FILES_PER_CHUNK, INFO_PATH, STATS_PATH
from roboverse_learn.data.dataset.stats import QUANTILES, Stats, column_stats, to_json
from roboverse_learn.data.dataset.tables import parquet_bytes, read_parquet
from roboverse_learn.folder_lock import lock_directory

_LOG = logging.getLogger(__name__)
_CHUNK_AND_FILE = re.compile(r"chunk-(\d+)/file-(\d+)\.(mp4|parquet)$")
_RAW = re.compile(r"episode_(\d+)\.safetensors$")
_OWN = re.compile(
    r"meta/((info|stats|collection|import|augment)\.json|tasks\.parquet|episodes/chunk-\d+/file-\d+\.parquet)"
    r"|data/chunk-\d+/file-\d+\.parquet|videos/[^/]+/chunk-\d+/file-\d+\.mp4|raw/episode_\d+\.safetensors"
)
"""Paths of the files of a dataset that is written here, below its folder."""


def recover(root: str | Path) -> int:
    """Removes what an uncommitted episode left, and makes totals and statistics those of what is committed.

    Opening and closing a :class:`~roboverse_learn.data.dataset.writer.DatasetWriter` does the same. Staged
    episodes, which are complete, are kept: collecting again commits them.

    Args:
        root: The dataset's folder.

    Returns:
        The number of complete episodes.

    Raises:
        DatasetError: There is no dataset, another process writes it, or a committed file is damaged.
    """
    root = Path(root)
    read_info(root)
    lock = lock_directory(root)
    try:
        rows = repair(root)
        finish_stats(root, combined_stats(rows))
        return len(rows)
    finally:
        lock.release()


def other_file(root: Path) -> str | None:
    """Returns the path, below a folder, of a file that no writer of ours makes; None if there is none.

    Files and folders whose names start with a dot do not count.
    """
    for folder, folders, files in os.walk(root):
        folders[:] = sorted(name for name in folders if not name.startswith("."))
        for name in sorted(files):
            path = (Path(folder) / name).relative_to(root).as_posix()
            if not name.startswith(".") and not _OWN.fullmatch(path):
                return path
    return None


def refuse_other_files(root: Path) -> None:
    """Checks that a folder is a dataset, what a killed writer left of one, empty, or absent.

    Raises:
        DatasetError: It holds other files, or episodes of a dataset whose description was lost.
    """
    if (root / INFO_PATH).is_file():
        return
    if other := other_file(root):
        raise DatasetError(
            f"The folder '{root}' is no dataset and holds other files, such as '{other}'. Name an empty or a "
            "new folder."
        )
    if episode := _episode_file(root):  # no kill leaves this: the description is written first
        raise DatasetError(
            f"The dataset '{root}' holds '{episode}' and has lost {INFO_PATH}. Restore its folder meta from "
            "a copy, or delete the dataset."
        )


def repair(root: Path) -> list[dict[str, Any]]:
    """Does the work of :func:`recover`, but for exact quantiles, for a caller that holds the lock.

    Returns:
        The rows of the complete episodes, with their statistics.
    """
    remove_partial_files(root)
    rows = read_episodes(root, with_stats=True)
    if rows and METADATA_COLUMN not in rows[0]:
        raise _foreign(root)
    info, total = read_info(root), len(rows)
    if info["total_episodes"] > total:  # no kill leaves this: a row is written before it is counted
        raise broken_file(
            root / "meta" / "episodes", f"{total} of {info['total_episodes']} episodes are listed"
        )
    removed = _remove_leftovers(root, rows)
    _truncate_data(root, rows)
    if info["total_episodes"] != total:
        info["total_episodes"], info["splits"] = total, {"train": f"0:{total}"}
        info["total_frames"] = rows[-1]["dataset_to_index"] if rows else 0
        info["total_tasks"] = len({task for row in rows for task in row["tasks"]})
        write_json(root / INFO_PATH, info)
    if rows and not _has_stats(root, info["total_frames"]):
        write_json(root / STATS_PATH, to_json(combined_stats(rows)))
    if removed:
        _LOG.info("Removed %d files of an uncommitted episode from %s.", removed, root)
    return rows


def _has_stats(root: Path, num_frames: int) -> bool:
    """Whether the statistics of a dataset can be read and are of all its frames."""
    try:
        return int(read_stats(root / STATS_PATH)["index"]["count"].item()) == num_frames
    except (DatasetError, KeyError, TypeError, ValueError, OverflowError):
        return False


def finish_stats(root: Path, stats: Stats) -> None:
    """Writes the statistics of a dataset, with the exact quantiles of its numeric columns.

    Args:
        root: The dataset's folder.
        stats: :func:`combined_stats` of its episodes; empty of a dataset without any.
    """
    if not stats:
        return
    exact = column_stats(DatasetInfo.open(root).read_columns())
    quantiles = {key: {name: one[name] for name in QUANTILES} for key, one in exact.items()}
    finished = {key: one | quantiles.get(key, {}) for key, one in stats.items()}
    write_json(root / STATS_PATH, to_json(finished))


def _episode_file(root: Path) -> str | None:
    """Returns the path, below a folder, of a file with frames of an episode; None if there is none."""
    found = (path for part in ("data", "videos", "raw") for path in sorted((root / part).rglob("*.*")))
    paths = (path.relative_to(root).as_posix() for path in found)
    return next((path for path in paths if _OWN.fullmatch(path)), None)


def _foreign(root: Path) -> DatasetError:
    return DatasetError(
        f"The dataset '{root}' was written by another program and can be read but not continued. Choose "
        "another folder."
    )


def _remove_leftovers(root: Path, rows: list[dict[str, Any]]) -> int:
    """Deletes videos and raw states numbered above the last committed episode, and data files past it."""
    leftovers = [path for path in (root / "videos").rglob("*.mp4") if _number(path) >= len(rows)]
    for path in (root / "raw").glob("*.safetensors"):
        match = _RAW.search(path.name)
        if match and int(match[1]) >= len(rows):
            leftovers.append(path)
    last = rows[-1] if rows else {"data/chunk_index": 0, "data/file_index": -1}
    last_number = last["data/chunk_index"] * FILES_PER_CHUNK + last["data/file_index"]
    leftovers += [path for path in (root / "data").rglob("*.parquet") if _number(path) > last_number]
    for path in leftovers:
        path.unlink()
    return len(leftovers)


def _number(path: Path) -> int:
    """Returns the running number of a chunk's file."""
    match = _CHUNK_AND_FILE.search(path.as_posix())
    return int(match[1]) * FILES_PER_CHUNK + int(match[2]) if match else -1


def _truncate_data(root: Path, rows: list[dict[str, Any]]) -> None:
    """Drops the rows of an uncommitted episode from the last data file."""
    if not rows:
        return
    last = rows[-1]
    chunk, file = last["data/chunk_index"], last["data/file_index"]
    path = root / f"data/chunk-{chunk:03d}/file-{file:03d}.parquet"
    table = read_parquet(path)
    in_file = [r for r in rows if (r["data/chunk_index"], r["data/file_index"]) == (chunk, file)]
    expected = sum(row["length"] for row in in_file)
    if table.num_rows > expected:
        start = in_file[0]["dataset_from_index"]
        groups = [table.slice(r["dataset_from_index"] - start, r["length"]) for r in in_file]
        write_file(path, parquet_bytes(groups))
