"""Collects demonstrations with several processes into one dataset that is complete at every moment.

Workers (:mod:`roboverse_learn.data.collection.worker`) run the simulator, encode, and stage finished
episodes. This process alone commits, in the order of the candidates. So the dataset is the first
``num_episodes`` successes of the candidate list, whatever the number of workers, and a kill loses only
episodes that run: :mod:`roboverse_learn.data.collection.schedule` finds what earlier runs left, and commits
staged ones when the same call runs again.
"""

import contextlib
import time
from collections.abc import Callable
from dataclasses import dataclass
from typing import TYPE_CHECKING

from envs.core.errors import DatasetError
from roboverse_learn.data.collection.config import CollectionConfig
from roboverse_learn.data.collection.pool import attempts, check_not_in_a_worker
from roboverse_learn.data.collection.schedule import Schedule
from roboverse_learn.data.dataset.images import damaged_videos
from roboverse_learn.data.dataset.info import DatasetInfo
from roboverse_learn.data.dataset.raw import check_all_raw, dataset_hash
from roboverse_learn.data.dataset.writer import DatasetWriter

if TYPE_CHECKING:
    from roboverse_learn.data.importers.verdicts import ImportSummary


@dataclass(frozen=True, kw_only=True, slots=True)
class CollectionProgress:
    """Progress of a collection.

    Attributes:
        num_episodes: Successful episodes on disk, those of earlier runs included.
        target: Successful episodes wanted.
        num_attempts: Episodes tried, those of earlier runs included.
        num_frames: Frames in the dataset.
        frames_per_s: Frames added per second of this run.
        remaining_s: Estimated time to the end; None before the first success of this run.
    """

    num_episodes: int
    target: int
    num_attempts: int
    num_frames: int
    frames_per_s: float
    remaining_s: float | None

    @property
    def success_rate(self) -> float:
        """Successful share of the attempts."""
        return self.num_episodes / max(self.num_attempts, 1)

    @property
    def rates(self) -> str:
        """Success rate, known from the first attempt on, and speed: ``93.0 % succeed, 71 frames/s``."""
        tried = f"{100 * self.success_rate:.1f} % succeed, " if self.num_attempts else ""
        return f"{tried}{self.frames_per_s:.0f} frames/s"


@dataclass(frozen=True, kw_only=True, slots=True)
class CollectionSummary:
    """Result of a collection.

    Attributes:
        root: The dataset's folder.
        num_episodes: Successful episodes in it.
        num_frames: Their frames.
        num_attempts: Pool episodes tried, in all runs.
        success_rate: Successful share of the attempts.
        wall_time_s: Duration of this run.
        dataset_hash: :func:`~roboverse_learn.data.dataset.raw.dataset_hash`.
        outcome: How often the demonstrator succeeded, in words.
        imported: What became of each demonstration, where they were imported.
    """

    root: str
    num_episodes: int
    num_frames: int
    num_attempts: int
    success_rate: float
    wall_time_s: float
    dataset_hash: str
    outcome: str = ""
    imported: "ImportSummary | None" = None


def collect(
    config: CollectionConfig, on_progress: Callable[[CollectionProgress], None] | None = None
) -> CollectionSummary:
    """Collects until the dataset holds ``num_episodes`` successful episodes.

    Killed at any moment, the same call continues; episodes that are in the dataset, and pool episodes
    that failed, are not tried again. A run that fails before its first episode leaves nothing. Runs that
    want the same dataset at once wait for the first of them.

    Args:
        config: What to collect.
        on_progress: Called after every attempt, or after those that ended together.

    Raises:
        TooFewSuccessesError: The candidates do not give enough successes, or will not.
        DatasetError: The disk is full, a worker died, or the dataset was started with other settings, or has
            a damaged video, or raw states of an episode are missing or damaged.
    """
    check_not_in_a_worker()
    start = time.monotonic()
    settings = config.source_kwargs if config.settings is None else config.settings
    with DatasetWriter(
        config.root,
        fps=config.fps,
        features=config.features,
        robot_type=config.robot_type,
        encoder=config.encoder,
        wait=True,
    ) as writer:
        if writer.num_episodes:
            _check_files(DatasetInfo.open(config.root))
        schedule = Schedule(
            writer,
            config.candidates,
            config.num_episodes,
            settings,
            fewer_ok=config.fewer_ok,
            give_up_after=config.give_up_after,
        )
        report = _Reporter(writer, schedule, config.num_episodes, on_progress)
        if not schedule.finished:
            try:
                _run(config, schedule, report)
            except BaseException:
                if writer.is_empty and not schedule.num_failures:
                    writer.remove()
                raise
        num_frames = writer.num_frames
        num_attempts = schedule.num_successes + schedule.num_failures
        num_episodes = writer.num_episodes
    return CollectionSummary(
        root=str(config.root),
        num_episodes=num_episodes,
        num_frames=num_frames,
        num_attempts=num_attempts,
        success_rate=num_episodes / max(num_attempts, 1),
        wall_time_s=time.monotonic() - start,
        dataset_hash=dataset_hash(config.root),
    )


def _check_files(info: DatasetInfo) -> None:
    """Checks that what earlier runs collected can be trained on and rendered again.

    Raises:
        DatasetError: A video is absent or damaged, or lacks frames, or raw states of an episode are.
    """
    if damaged := damaged_videos(info):
        every = f" {len(damaged)} videos are damaged: roboverse dataset info dataset={info.root} names each."
        raise DatasetError(f"{damaged[0]}{every * (len(damaged) > 1)}")
    check_all_raw(info)


def _run(config: CollectionConfig, schedule: Schedule, report: "_Reporter") -> None:
    """Runs candidates until the schedule has enough successes."""
    with contextlib.closing(attempts(config, lambda: schedule.next_batch(config.batch_size))) as results:
        for ended in results:
            schedule.resolve(*ended)
            report()


class _Reporter:
    """Reports progress to the caller."""

    def __init__(
        self,
        writer: DatasetWriter,
        schedule: Schedule,
        target: int,
        callback: Callable[[CollectionProgress], None] | None,
    ) -> None:
        self._writer, self._schedule, self._target, self._callback = writer, schedule, target, callback
        self._start = time.monotonic()
        self._first_frames, self._first_episodes = writer.num_frames, schedule.num_successes
        self()

    def __call__(self) -> None:
        if self._callback is None:
            return
        elapsed = max(time.monotonic() - self._start, 1e-9)
        done = self._schedule.num_successes
        fresh = done - self._first_episodes
        self._callback(
            CollectionProgress(
                num_episodes=done,
                target=self._target,
                num_attempts=done + self._schedule.num_failures,
                num_frames=self._writer.num_frames,
                frames_per_s=(self._writer.num_frames - self._first_frames) / elapsed,
                remaining_s=elapsed / fresh * max(self._target - done, 0) if fresh else None,
            )
        )
