"""What a collection runs, and the processes that run it."""

import contextlib
import os
import signal
from collections.abc import Callable, Iterator, Mapping, Sequence
from concurrent.futures import FIRST_COMPLETED, Future, ProcessPoolExecutor, wait
from concurrent.futures.process import BrokenProcessPool
from dataclasses import dataclass, field, replace
from multiprocessing import active_children, get_context
from multiprocessing.process import BaseProcess
from pathlib import Path
from typing import Any

from envs.core.errors import ConfigError, DatasetError
from roboverse_learn.data.collection.schedule import GIVE_UP_AFTER
from roboverse_learn.data.collection.worker import Attempt, run_batch, start, work
from roboverse_learn.data.dataset.schema import Feature
from roboverse_learn.data.dataset.staging import STAGING_DIRECTORY
from roboverse_learn.data.dataset.video import EncoderConfig
from roboverse_learn.data.sources.base import EpisodeSource, load_source


@dataclass(frozen=True, kw_only=True)
class CollectionConfig:
    """What to collect.

    Attributes:
        root: The dataset's folder; an existing one is continued.
        num_episodes: Successful episodes wanted in it.
        candidates: Pool indices in the order of preference, such as a split's.
        source: ``"package.module:Class"`` of an :class:`~roboverse_learn.data.sources.base.EpisodeSource`.
        source_kwargs: Its JSON-able arguments.
        fps: Frames per second.
        features: From :func:`~roboverse_learn.data.dataset.schema.make_features`.
        robot_type: Name of the robot.
        num_workers: Processes; 1 collects in this process.
        batch_size: Pool episodes that a worker runs at once, such as the number of its environments.
        settings: JSON-able; what continuing the dataset must have in common with its beginning, such as
            task, level, seed. ``source_kwargs`` by default.
        encoder: Video settings.
        fewer_ok: Once every candidate was tried, fewer successes than ``num_episodes`` are a result too.
        give_up_after: Failures of a call before it may end because too few episodes succeed.
    """

    root: str | Path
    num_episodes: int
    candidates: Sequence[int]
    source: str
    source_kwargs: Mapping[str, Any]
    fps: int
    features: Mapping[str, Feature]
    robot_type: str | None = None
    num_workers: int = 1
    batch_size: int = 1
    settings: Mapping[str, Any] | None = None
    encoder: EncoderConfig = field(default_factory=EncoderConfig)
    fewer_ok: bool = False
    give_up_after: int = GIVE_UP_AFTER

    def __post_init__(self) -> None:
        for key in ("num_episodes", "num_workers", "batch_size"):
            if getattr(self, key) < 1:
                raise ConfigError(f"{key} must be at least 1, given {getattr(self, key)}.")
        if len(set(self.candidates)) != len(self.candidates):
            raise ConfigError("The candidates name a pool episode twice. Give each index once.")

    def make_source(self) -> EpisodeSource:
        """Returns the source; see :func:`~roboverse_learn.data.sources.base.load_source`."""
        return load_source(self.source, self.source_kwargs)


def attempts(config: CollectionConfig, next_batch: Callable[[], list[int]]) -> Iterator[Attempt]:
    """Runs batches of pool episodes until there is none, in this process or in several.

    Args:
        config: What to collect.
        next_batch: Called for the next pool indices; none while those that run may be enough.

    Raises:
        DatasetError: A source failed, a worker died, or the disk is full.
    """
    if config.num_workers == 1:
        with contextlib.closing(config.make_source()) as source:
            while batch := next_batch():
                yield from run_batch(config, source, batch, num_cores())
        return
    yield from _attempts_of_workers(config, next_batch)


def _attempts_of_workers(config: CollectionConfig, next_batch: Callable[[], list[int]]) -> Iterator[Attempt]:
    logs = Path(config.root) / STAGING_DIRECTORY
    logs.mkdir(parents=True, exist_ok=True)
    others, workers = set(active_children()), set[BaseProcess]()
    running: set[Future[list[Attempt]]] = set()
    initial = (replace(config, candidates=()), logs)
    with ProcessPoolExecutor(config.num_workers, get_context("spawn"), start, initial) as pool:
        try:
            while True:
                while len(running) < config.num_workers and (batch := next_batch()):
                    with _starting(config.num_workers):
                        running.add(pool.submit(work, batch))
                    workers |= set(active_children()) - others
                if not running:
                    break
                done, running = wait(running, return_when=FIRST_COMPLETED)
                for future in done:
                    yield from future.result()
        except BrokenProcessPool as error:
            pool.shutdown()
            ended = {str(worker.exitcode) for worker in workers} - {"0", str(-signal.SIGTERM)}
            code = ", ".join(sorted(ended)) or "unknown"
            raise DatasetError(
                f"A collection worker died (exit code {code}; out of memory?). "
                f"Logs are in '{logs}'. The episodes so far are safe; run the same command again, with fewer "
                "workers if memory was short."
            ) from error
        except BaseException:  # an interruption too: batches that run are not waited for
            for worker in workers:
                worker.terminate()
            raise
    for log in logs.glob("worker_*.log"):
        log.unlink()


@contextlib.contextmanager
def _starting(num_workers: int) -> Iterator[None]:
    """Surrounds the start of workers: they share the cores, and Ctrl-C is blocked until they ignore it."""
    given = os.environ.get("OMP_NUM_THREADS")
    os.environ["OMP_NUM_THREADS"] = given or str(max(num_cores() // num_workers, 1))
    if hasattr(signal, "pthread_sigmask"):
        signal.pthread_sigmask(signal.SIG_BLOCK, {signal.SIGINT})
    try:
        yield
    finally:
        if given is None:
            del os.environ["OMP_NUM_THREADS"]
        if hasattr(signal, "pthread_sigmask"):
            signal.pthread_sigmask(signal.SIG_UNBLOCK, {signal.SIGINT})


def num_cores() -> int:
    """Returns the CPU cores that this process may use."""
    return len(os.sched_getaffinity(0)) if hasattr(os, "sched_getaffinity") else os.cpu_count() or 1
