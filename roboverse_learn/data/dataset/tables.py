"""Parquet tables of a dataset: runs of files that only ever grow at the end, each write atomic."""

import io
from collections.abc import Mapping
from pathlib import Path
from typing import TYPE_CHECKING

import numpy as np

from envs.core.atomic import write_file
from envs.core.errors import DatasetError
from roboverse_learn.data.dataset.damage import broken_file
from roboverse_learn.data.dataset.schema import Feature, chunk_and_file

if TYPE_CHECKING:
    import pyarrow as pa

# The last file is rewritten for every episode, so it must stay small; the files must not be too many.
EPISODES_PER_FILE = 64


class GrowingTable:
    """One table over the files ``chunk-XXX/file-XXX.parquet``, 64 episodes to a file.

    Args:
        root: The dataset's folder.
        template: Path of a file below it, with ``chunk_index`` and ``file_index``.
        num_files: How many files exist already; the last of them may have room.
        group_per_episode: Whether each episode is a row group of its own, as LeRobot writes frames.
    """

    def __init__(self, root: Path, template: str, num_files: int = 0, *, group_per_episode: bool) -> None:
        self._root = root
        self._template = template
        self._group_per_episode = group_per_episode
        self._number = max(num_files - 1, 0)
        self._count = 0
        self._groups: list[pa.Table] = []
        if num_files:
            self._groups = _row_groups(self._path(self._number))
            rows = sum(group.num_rows for group in self._groups)
            self._count = len(self._groups) if group_per_episode else rows

    def _path(self, number: int) -> Path:
        chunk, file = chunk_and_file(number)
        return self._root / self._template.format(chunk_index=chunk, file_index=file)

    @property
    def room(self) -> int:
        """How many episodes the file of the next one takes yet."""
        return EPISODES_PER_FILE - self._count % EPISODES_PER_FILE

    def position(self) -> tuple[int, int]:
        """Returns (chunk index, file index) of the file for the next episode."""
        return chunk_and_file(self._number + (self._count >= EPISODES_PER_FILE))

    def append(self, *added: "pa.Table") -> None:
        """Adds episodes, at most :attr:`room`, and writes their file; on failure the table is as before.

        Args:
            *added: A table for each episode, or tables that have a row for each.

        Raises:
            DatasetError: The disk is full.
        """
        import pyarrow as pa

        count = len(added) if self._group_per_episode else sum(table.num_rows for table in added)
        assert count <= self.room
        full = self._count >= EPISODES_PER_FILE
        number = self._number + full
        groups = list(added) if full else [*self._groups, *added]
        if not self._group_per_episode:
            # One contiguous chunk per column: parquet takes 40 ms for 64 chunks and 3 ms for one.
            groups = [pa.concat_tables(groups).combine_chunks()]
        write_file(self._path(number), parquet_bytes(groups))
        self._number, self._groups = number, groups
        self._count = count + (0 if full else self._count)


def parquet_bytes(groups: list["pa.Table"]) -> bytes:
    """Returns a parquet file with one row group per table."""
    import pyarrow.parquet as pq

    buffer = io.BytesIO()
    with pq.ParquetWriter(buffer, groups[0].schema, compression="snappy", use_dictionary=False) as writer:
        for group in groups:
            writer.write_table(group)
    return buffer.getvalue()  # not getbuffer(), see video.encode_video


def _row_groups(path: Path) -> list["pa.Table"]:
    """Reads a file's row groups."""
    import pyarrow as pa
    import pyarrow.parquet as pq

    try:
        file = pq.ParquetFile(path)
        return [file.read_row_group(index) for index in range(file.num_row_groups)]
    except FileNotFoundError as error:
        raise DatasetError(f"'{path}' is missing. Restore it from a copy, or collect again.") from error
    except (pa.ArrowException, OSError) as error:
        raise broken_file(path, str(error)) from error


def read_parquet(path: Path, columns: list[str] | None = None) -> "pa.Table":
    """Reads one parquet file.

    Raises:
        DatasetError: The file is absent, truncated, or lacks a column.
    """
    import pyarrow as pa
    import pyarrow.parquet as pq

    try:
        table = pq.ParquetFile(path).read(columns=columns)
    except FileNotFoundError as error:
        raise DatasetError(f"'{path}' is missing. Restore it from a copy, or collect again.") from error
    except (pa.ArrowException, OSError) as error:
        raise broken_file(path, str(error)) from error
    missing = sorted(set(columns or ()) - set(table.column_names))
    if missing:
        raise broken_file(path, f"it lacks the columns {missing}")
    return table


def to_numpy(column: "pa.ChunkedArray", feature: Feature) -> np.ndarray:
    """Returns a numeric column as (rows,) or (rows, *shape), in the feature's dtype."""
    shape = tuple(feature["shape"])
    array = column.combine_chunks()
    while hasattr(array, "flatten") and hasattr(array.type, "value_type"):
        array = array.flatten()
    values = array.to_numpy(zero_copy_only=False).astype(feature["dtype"], copy=False)
    return values if shape == (1,) else values.reshape(len(column), *shape)


def to_arrow(columns: Mapping[str, np.ndarray], features: Mapping[str, Feature]) -> "pa.Table":
    """Builds an episode's table: scalars as values, vectors as lists of fixed size."""
    import pyarrow as pa

    arrays = {}
    for key, values in columns.items():
        feature = features[key]
        kind = pa.from_numpy_dtype(np.dtype(feature["dtype"]))
        flat = pa.array(np.ascontiguousarray(values).reshape(-1), type=kind)
        size = int(np.prod(feature["shape"]))
        arrays[key] = (
            flat if tuple(feature["shape"]) == (1,) else pa.FixedSizeListArray.from_arrays(flat, size)
        )
    return pa.table(arrays)
