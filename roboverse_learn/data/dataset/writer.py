"""Writes LeRobotDataset v3 so that the folder is a complete dataset after every commit.

The order of a commit, of one episode or several, makes every state on the way a valid dataset to LeRobot's
own reader:

1. the videos and raw states get their names (nothing lists them yet),
2. ``meta/tasks.parquet`` if the instruction is new,
3. the numeric columns are appended to ``data/`` (LeRobot reads ``total_frames`` rows and no more),
4. **the episodes' rows are appended to ``meta/episodes/``: this one rename is the commit**,
5. ``meta/stats.json`` and ``meta/info.json`` follow; both can be recomputed from the rows.

Each step is one atomic rename. :func:`recover` completes step 5 or undoes steps 1 to 3.
"""

import contextlib
import json
import shutil
from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import Any, Self

import numpy as np

from envs.core.atomic import (
    link_file,
    remove_partial_files,
    write_errors,
    write_file,
    write_json,
)
from envs.core.errors import DatasetError
from roboverse_learn.data.dataset import stats as statistics
from roboverse_learn.data.dataset.info import (
    METADATA_COLUMN,
    episode_key,
    read_episodes,
    read_info,
)
from roboverse_learn.data.dataset.info import read_tasks as read_task_names
from roboverse_learn.data.dataset.meta_tables import (
    combined_stats,
    episode_row,
    episode_stats,
    num_files,
    row_table,
    tasks_bytes,
)
from roboverse_learn.data.dataset.recovery import finish_stats, other_file, refuse_other_files, repair
from roboverse_learn.data.dataset.schema import (
    BOOKKEEPING,
    CODEBASE_VERSION,
    DATA_PATH,
    EPISODES_PATH,
    FILES_PER_CHUNK,
    INFO_PATH,
    RAW_PATH,
    STATS_PATH,
    TASKS_PATH,
    VIDEO_PATH,
    EpisodeData,
    Feature,
    check_episode,
    chunk_and_file,
    layout_difference,
    video_keys,
    with_bookkeeping,
)
from roboverse_learn.data.dataset.staging import STAGING_DIRECTORY, StagedEpisode, stage_episode
from roboverse_learn.data.dataset.tables import GrowingTable, to_arrow
from roboverse_learn.data.dataset.video import EncoderConfig
from roboverse_learn.folder_lock import LOCK, lock_directory


class DatasetWriter:
    """Creates or continues a dataset; one writer at a time.

    Use it as a context manager, or call :meth:`close`. A process that is killed instead loses the
    episode in flight and nothing else.

    Args:
        root: The dataset's folder, created if absent.
        fps: Frames per second.
        features: From :func:`~roboverse_learn.data.dataset.schema.make_features`.
        robot_type: Name of the robot, recorded for LeRobot.
        encoder: Video settings.
        wait: Wait while another process writes this dataset.

    Raises:
        DatasetError: Another process writes this dataset, it exists with other features or fps, or the folder
            holds other files.
    """

    def __init__(
        self,
        root: str | Path,
        *,
        fps: int,
        features: Mapping[str, Feature],
        robot_type: str | None = None,
        encoder: EncoderConfig | None = None,
        wait: bool = False,
    ) -> None:
        self.root = Path(root)
        self.fps = fps
        self.encoder = encoder or EncoderConfig()
        self.features = {key: dict(f) for key, f in features.items() if key not in BOOKKEEPING}
        for key in video_keys(self.features):
            height, width = self.features[key]["shape"][:2]
            self.features[key]["info"] = self.encoder.info(height, width, fps)
        self._robot_type = robot_type
        self._all_features = with_bookkeeping(self.features)
        refuse_other_files(self.root)
        self._is_new = not self.root.exists()
        with write_errors(self.root):
            self.root.mkdir(parents=True, exist_ok=True)
        self._lock = lock_directory(self.root, wait=wait)
        try:
            self._open()
        except BaseException:
            self._unlock()
            raise

    def __enter__(self) -> Self:
        return self

    def __exit__(self, *exc: object) -> None:
        # After an error there is nothing to finish: what was committed is complete as it is.
        if exc[0] is None:
            self.close()
        else:
            self._unlock()

    @property
    def num_episodes(self) -> int:
        """Episodes committed so far, those of earlier runs included."""
        return self._num_episodes

    @property
    def num_frames(self) -> int:
        """Frames committed so far."""
        return self._num_frames

    @property
    def episode_keys(self) -> frozenset[str]:
        """Keys (:func:`~roboverse_learn.data.dataset.info.episode_key`) of the committed pool episodes."""
        return frozenset(self._keys)

    @property
    def staging_directory(self) -> Path:
        """Folder of finished episodes that are not committed yet."""
        return self.root / STAGING_DIRECTORY

    def add_episode(self, episode: EpisodeData) -> int:
        """Encodes and commits one episode.

        Args:
            episode: It must have exactly the dataset's features.

        Returns:
            Its index in the dataset.

        Raises:
            DatasetError: The episode does not fit the dataset, or the disk is full.
        """
        self._check_open()
        check_episode(episode, self.features)
        directory = self.staging_directory / f"writer_{self._num_episodes:06d}"
        shutil.rmtree(directory, ignore_errors=True)
        return self.commit(stage_episode(directory, episode, self.fps, self.encoder))

    def commit(self, *staged: StagedEpisode) -> int:
        """Makes staged episodes the dataset's next ones and removes their staging folders.

        Several at once take little longer than one: the tables and the summary are written for all of them.

        Args:
            *staged: Their numeric columns and videos must be the dataset's.

        Returns:
            The last one's index in the dataset.

        Raises:
            DatasetError: The disk is full; the dataset is then complete, without all or the last of them.
        """
        self._check_open()
        left = staged
        try:
            while left:
                room = self._rows.room
                self._commit(left[:room])
                left = left[room:]
        except BaseException:
            try:
                self._open()  # back to what the disk holds
            except Exception:
                self._unlock()
            raise
        for episode in staged:
            episode.discard()
        return self._num_episodes - 1

    def close(self) -> None:
        """Makes the quantiles exact and releases the dataset; calling it again does nothing."""
        if self._lock is None:
            return
        try:
            finish_stats(self.root, self._stats)
            with contextlib.suppress(OSError):
                self.staging_directory.rmdir()
        finally:
            self._unlock()

    @property
    def is_empty(self) -> bool:
        """Whether the folder is what a collection without an episode leaves: none is committed or staged."""
        return (
            read_info(self.root)["total_episodes"] == 0
            and not read_episodes(self.root)
            and not any(self.staging_directory.glob("pool_*"))
            and other_file(self.root) is None
        )

    def remove(self) -> None:
        """Removes a dataset without an episode and releases it; logs that say something stay."""
        assert self.is_empty
        remove_partial_files(self.root)
        for log in self.staging_directory.glob("*.log"):
            if log.stat().st_size == 0:
                log.unlink()
        shutil.rmtree(self.root / "meta", ignore_errors=True)
        with contextlib.suppress(OSError):  # logs of workers are there
            if self.staging_directory.exists():
                self.staging_directory.rmdir()
            if self._is_new:
                (self.root / LOCK).unlink(missing_ok=True)
                self.root.rmdir()
        self._unlock()

    def _unlock(self) -> None:
        if self._lock is not None:
            self._lock.release()
            self._lock = None

    def _check_open(self) -> None:
        if self._lock is None:
            raise DatasetError(f"The writer of '{self.root}' is closed. Open a new DatasetWriter.")

    def _difference(self) -> str:
        """Returns how the dataset on disk differs from what was given, in words; empty if it does not."""
        info = read_info(self.root)
        if info["fps"] != self.fps:
            return f"{info['fps']} and {self.fps} fps"
        return layout_difference(info["features"], self.features)

    def _open(self) -> None:
        """Reads the committed state from the disk, after repairing what a kill left behind."""
        if not (self.root / INFO_PATH).exists() or (self._difference() and self.is_empty):
            self._num_episodes = self._num_frames = 0
            self._tasks: list[str] = []
            write_json(self.root / INFO_PATH, self._info())
        if difference := self._difference():
            raise DatasetError(
                f"The dataset '{self.root}' and the episodes to be added have {difference}. Choose another "
                "folder, or delete this one."
            )
        rows = repair(self.root)
        self._num_episodes = len(rows)
        self._num_frames = rows[-1]["dataset_to_index"] if rows else 0
        self._tasks = read_task_names(self.root) if (self.root / TASKS_PATH).exists() else []
        self._stats = combined_stats(rows)
        self._keys = {k for row in rows if (k := episode_key(json.loads(row.get(METADATA_COLUMN) or "{}")))}
        self._data = GrowingTable(self.root, DATA_PATH, num_files(rows, "data"), group_per_episode=True)
        row_files = num_files(rows, "meta/episodes")
        self._rows = GrowingTable(self.root, EPISODES_PATH, row_files, group_per_episode=False)

    def _commit(self, episodes: Sequence[StagedEpisode]) -> None:
        """The five steps of the module's docstring, for episodes whose rows go into one file."""
        first = self._num_episodes
        for index, staged in enumerate(episodes, first):
            self._name_files(staged, index)
        tasks = list(dict.fromkeys([*self._tasks, *(staged.task for staged in episodes)]))
        if tasks != self._tasks:
            write_file(self.root / TASKS_PATH, tasks_bytes(tasks))
            self._tasks = tasks
        numeric = {key: f for key, f in self._all_features.items() if f["dtype"] != "video"}
        groups, rows, frames, total = [], [], self._num_frames, self._stats
        for index, staged in enumerate(episodes, first):
            columns = self._all_columns(staged, index, frames)
            stats = episode_stats(staged, columns, self._all_features)
            row = episode_row(
                staged,
                stats,
                index=index,
                first_frame=frames,
                fps=self.fps,
                data_file=self._data.position(),
                row_file=self._rows.position(),
            )
            groups.append(to_arrow({key: columns[key] for key in numeric}, numeric))
            rows.append(row)
            frames += staged.length
            total = statistics.merge_stats(total, stats)
        self._data.append(*groups)
        self._rows.append(row_table(rows))
        self._num_episodes, self._num_frames, self._stats = first + len(episodes), frames, total
        self._keys |= {key for staged in episodes if (key := episode_key(staged.metadata))}
        self._write_summary()

    def _name_files(self, staged: StagedEpisode, index: int) -> None:
        """Gives an episode's videos and raw states their names in the dataset."""
        chunk, file = chunk_and_file(index)
        for key in video_keys(self.features):
            path = VIDEO_PATH.format(video_key=key, chunk_index=chunk, file_index=file)
            link_file(staged.video_file(key), self.root / path)
        link_file(staged.raw_file, self.root / RAW_PATH.format(episode_index=index))

    def _all_columns(self, staged: StagedEpisode, index: int, first_frame: int) -> dict[str, np.ndarray]:
        """Adds LeRobot's bookkeeping columns."""
        frames = np.arange(staged.length)
        return staged.columns | {
            "timestamp": (frames / self.fps).astype(np.float32),
            "frame_index": frames,
            "episode_index": np.full(staged.length, index),
            "index": first_frame + frames,
            "task_index": np.full(staged.length, self._tasks.index(staged.task)),
        }

    def _info(self) -> dict[str, Any]:
        """Returns the content of ``meta/info.json``, with LeRobot's keys only."""
        return {
            "codebase_version": CODEBASE_VERSION,
            "fps": self.fps,
            "features": self._all_features,
            "total_episodes": self._num_episodes,
            "total_frames": self._num_frames,
            "total_tasks": len(self._tasks),
            "chunks_size": FILES_PER_CHUNK,
            "data_files_size_in_mb": 100,
            "video_files_size_in_mb": 200,
            "data_path": DATA_PATH,
            "video_path": VIDEO_PATH if video_keys(self.features) else None,
            "robot_type": self._robot_type,
            "splits": {"train": f"0:{self._num_episodes}"},
        }

    def _write_summary(self) -> None:
        """Writes what is computed from the episodes' rows."""
        write_json(self.root / STATS_PATH, statistics.to_json(self._stats))
        write_json(self.root / INFO_PATH, self._info())
