"""The tables of ``meta/``: one row per episode, one row per instruction."""

import io
import json
from collections.abc import Mapping, Sequence
from typing import TYPE_CHECKING, Any

import numpy as np

from roboverse_learn.data.dataset import stats as statistics
from roboverse_learn.data.dataset.info import METADATA_COLUMN
from roboverse_learn.data.dataset.schema import FILES_PER_CHUNK, Feature, chunk_and_file
from roboverse_learn.data.dataset.staging import StagedEpisode

if TYPE_CHECKING:
    import pyarrow as pa

FileNumber = tuple[int, int]


def episode_stats(
    staged: StagedEpisode, columns: Mapping[str, np.ndarray], features: Mapping[str, Feature]
) -> statistics.Stats:
    """Returns an episode's statistics by feature key."""
    numeric = {key: columns[key] for key, f in features.items() if f["dtype"] != "video"}
    found = statistics.column_stats(numeric) | staged.image_stats
    return {key: found[key] for key in features}


def episode_row(
    staged: StagedEpisode,
    stats: statistics.Stats,
    *,
    index: int,
    first_frame: int,
    fps: int,
    data_file: FileNumber,
    row_file: FileNumber,
) -> dict[str, Any]:
    """Returns an episode's row of ``meta/episodes``, with LeRobot's columns and our metadata.

    Args:
        staged: The episode.
        stats: Its statistics.
        index: Its index in the dataset, and the number of its videos.
        first_frame: Frames before it.
        fps: Frames per second.
        data_file: (chunk, file) of its numeric columns.
        row_file: (chunk, file) of this row.
    """
    row: dict[str, Any] = {
        "episode_index": index,
        "tasks": [staged.task],
        "length": staged.length,
        "data/chunk_index": data_file[0],
        "data/file_index": data_file[1],
        "dataset_from_index": first_frame,
        "dataset_to_index": first_frame + staged.length,
    }
    chunk, file = chunk_and_file(index)
    for key in staged.image_stats:
        row[f"videos/{key}/chunk_index"], row[f"videos/{key}/file_index"] = chunk, file
        row[f"videos/{key}/from_timestamp"], row[f"videos/{key}/to_timestamp"] = 0.0, staged.length / fps
    for key, one in stats.items():
        row |= {f"stats/{key}/{name}": one[name].tolist() for name in statistics.STATISTICS}
    row["meta/episodes/chunk_index"], row["meta/episodes/file_index"] = row_file
    row[METADATA_COLUMN] = json.dumps(staged.metadata, sort_keys=True)
    return row


def combined_stats(rows: Sequence[Mapping[str, Any]]) -> statistics.Stats:
    """Returns the statistics of the episodes of rows together, their quantiles averaged; empty of none."""
    return statistics.combine(row_stats(row) for row in rows) or {}


def row_stats(row: Mapping[str, Any]) -> statistics.Stats:
    """Reads an episode's statistics out of its row."""
    stats: statistics.Stats = {}
    for name, value in row.items():
        if name.startswith("stats/"):
            key, statistic = name.removeprefix("stats/").rsplit("/", 1)
            stats.setdefault(key, {})[statistic] = np.asarray(value)
    return stats


def num_files(rows: list[dict[str, Any]], prefix: str) -> int:
    """Returns how many files the rows' table takes."""
    if not rows:
        return 0
    return rows[-1][f"{prefix}/chunk_index"] * FILES_PER_CHUNK + rows[-1][f"{prefix}/file_index"] + 1


def row_table(rows: Sequence[Mapping[str, Any]]) -> "pa.Table":
    """Builds a table of rows of the same columns, whose types do not depend on the values."""
    import pyarrow as pa

    return pa.table({name: pa.array([row[name] for row in rows]) for name in rows[0]})


def tasks_bytes(tasks: list[str]) -> bytes:
    """Returns ``meta/tasks.parquet``: LeRobot reads it with pandas, the instruction is the index."""
    import pandas as pd

    frame = pd.DataFrame({"task_index": range(len(tasks))}, index=pd.Index(tasks, name="task"))
    buffer = io.BytesIO()
    frame.to_parquet(buffer)
    return buffer.getvalue()
