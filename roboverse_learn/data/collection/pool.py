"""The processes of a collection."""

import contextlib
import itertools
import os
import signal
import sys
import time
from collections.abc import Callable, Generator, Iterable, Iterator
from concurrent.futures import FIRST_COMPLETED, Future, ProcessPoolExecutor, wait
from concurrent.futures.process import BrokenProcessPool
from dataclasses import replace
from multiprocessing import active_children, current_process, get_context
from multiprocessing.process import BaseProcess
from pathlib import Path
from threading import Lock
from typing import Any

from envs.core.errors import DatasetError
from envs.core.machine import num_cores
from envs.core.registry import registered_by_hand
from roboverse_learn.data.collection.config import CollectionConfig
from roboverse_learn.data.collection.worker import Attempt, Stage, encoded_by, run_batches, start, work
from roboverse_learn.data.dataset.staging import STAGING_DIRECTORY
from roboverse_learn.data.processes import script_of_processes


def attempts(config: CollectionConfig, next_batch: Callable[[], list[int]]) -> Generator[list[Attempt]]:
    """Runs batches of pool episodes until there is none, in this process or in several.

    Yields the attempts that ended together: in this process within a second, of others those of a batch.

    Args:
        config: What to collect.
        next_batch: Called for the next pool indices; none while those that run may be enough.

    Raises:
        DatasetError: A source failed, a worker died, or the disk is full.
    """
    if config.num_workers == 1:
        with _encoders(config) as stage, contextlib.closing(config.make_source()) as source:
            threads = config.num_encoders or num_cores()
            while batch := next_batch():  # asked again at the end: it learns of failures as they are yielded
                batches = itertools.chain([batch], iter(next_batch, []))
                yield from together(run_batches(config, source, batches, threads, stage))
        return
    yield from _attempts_of_workers(config, next_batch)


def together(attempts: Iterable[Attempt], within_s: float = 1.0) -> Iterator[list[Attempt]]:
    """Groups attempts that end within a second: committing several takes little longer than committing one.

    What ended before an error is yielded before it is raised.
    """
    ended, since = list[Attempt](), time.monotonic()
    try:
        for attempt in attempts:
            ended.append(attempt)
            if time.monotonic() - since >= within_s:
                yield ended
                ended, since = [], time.monotonic()
    except Exception:
        if ended:
            yield ended
        raise
    if ended:
        yield ended


def _attempts_of_workers(
    config: CollectionConfig, next_batch: Callable[[], list[int]]
) -> Generator[list[Attempt]]:
    running: set[Future[list[Attempt]]] = set()
    with _processes(config, config.num_workers) as submit:
        while True:
            while len(running) < config.num_workers and (batch := next_batch()):
                running.add(submit(work, batch))
            if not running:
                break
            done, running = wait(running, return_when=FIRST_COMPLETED)
            yield [attempt for future in done for attempt in future.result()]


@contextlib.contextmanager
def _encoders(config: CollectionConfig) -> Iterator[Stage | None]:
    """Starts the processes that encode, if there are to be any; yields what stages an episode in them."""
    if not config.num_encoders:
        yield None
        return
    with _processes(config, config.num_encoders) as submit:
        for _ in range(config.num_encoders):  # they start while the simulator does
            submit(os.getpid)
        yield encoded_by(submit)


@contextlib.contextmanager
def _processes(config: CollectionConfig, count: int) -> Iterator[Callable[..., Future[Any]]]:
    """Keeps processes of a collection; yields what submits a call to one of them.

    Raises:
        DatasetError: One of them died.
    """
    logs = Path(config.root) / STAGING_DIRECTORY
    logs.mkdir(parents=True, exist_ok=True)
    others, workers = set(active_children()), set[BaseProcess]()
    initial = (replace(config, candidates=()), logs)
    script = sys.modules["__main__"] if _needs_script(config) else None
    starting = Lock()  # threads may submit, and what surrounds a start is of the whole process
    with ProcessPoolExecutor(count, get_context("spawn"), start, initial) as pool:

        def submit(function: Callable[..., Any], *args: Any) -> Future[Any]:
            if len(workers) == count:  # all have started
                return pool.submit(function, *args)
            with starting, _starting(count), script_of_processes(script):
                future = pool.submit(function, *args)
            workers.update(set(active_children()) - others)
            return future

        try:
            yield submit
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


def check_not_in_a_worker() -> None:
    """Raises an error in a worker that runs its parent's script again: it would wait for its parent.

    Raises:
        DatasetError: This process is such a worker.
    """
    if getattr(current_process(), "_inheriting", False):  # what multiprocessing itself asks for its own error
        raise DatasetError(
            "The processes of a collection run the script again to know what it registers "
            f"({', '.join(registered_by_hand()) or 'nothing so far'}), and it collects again. Put the call "
            'below if __name__ == "__main__": or give num_workers=1.'
        )


def _needs_script(config: CollectionConfig) -> bool:
    """Returns whether workers must run the script to know what they collect."""
    return config.source.startswith("__main__:") or bool(registered_by_hand())


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
