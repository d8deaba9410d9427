"""Processes on this machine, which share its GPUs and cores."""

import logging
import os
import queue
from collections.abc import Callable, Collection, Mapping, Sequence
from concurrent.futures import FIRST_COMPLETED, Future, ThreadPoolExecutor, wait
from pathlib import Path
from typing import override

from envs.core.machine import num_cores
from roboverse_learn.commands.child_process import Children
from roboverse_learn.launch.base import Job, Launcher, OnEnd

log = logging.getLogger(__name__)


class LocalLauncher(Launcher):
    """As many processes at once as there are GPUs times ``jobs_per_gpu``; they end with this process."""

    @override
    def run(self, jobs: Sequence[Job], logs: Path, on_end: OnEnd) -> dict[str, int | None]:
        return run_processes(jobs, gpu_slots(self.jobs_per_gpu), logs, on_end)


def run_processes(
    jobs: Sequence[Job], slots: Sequence[Mapping[str, str]], logs: Path, on_end: OnEnd
) -> dict[str, int | None]:
    """Runs jobs as processes of this machine, which end with this one; see :func:`run_jobs`."""
    children = Children()
    log.info("%d at a time on this machine.", len(slots))

    def start(job: Job, slot: Mapping[str, str]) -> int:
        return _start(children, job, slot, logs / f"{job.name}.log", len(slots))

    return run_jobs(jobs, slots, start, on_end, children.end)


def run_jobs(
    jobs: Sequence[Job],
    slots: Sequence[Mapping[str, str]],
    start: Callable[[Job, Mapping[str, str]], int],
    on_end: OnEnd,
    end: Callable[[], None] = lambda: None,
) -> dict[str, int | None]:
    """Runs jobs, as many at once as there are slots, each after the one that it waits for.

    Args:
        jobs: What to run.
        slots: Environment variables that give a process its place.
        start: Runs one job in one slot and returns its exit code.
        on_end: Hears of every job and its code.
        end: Ends the jobs that run. It is called on Ctrl-C and on SIGTERM, and again on the second of them.

    Returns:
        Exit code by name; None of those whose predecessor failed.
    """
    free: queue.SimpleQueue[Mapping[str, str]] = queue.SimpleQueue()
    for slot in slots:
        free.put(slot)

    def in_a_slot(job: Job) -> int:
        slot = free.get()
        try:
            return start(job, slot)
        finally:
            free.put(slot)

    waiting, codes = list(jobs), {}
    running: dict[Future[int], Job] = {}
    with ThreadPoolExecutor(len(slots)) as pool:
        try:
            while waiting or running:
                ready = [job for job in waiting if job.after is None or job.after in codes]
                for job in ready:
                    if len(running) == len(slots):
                        break
                    waiting.remove(job)
                    if job.after is not None and codes[job.after] != 0:
                        codes[job.name] = None
                        on_end(job, None)
                    else:
                        running[pool.submit(in_a_slot, job)] = job
                for future in wait(running, return_when=FIRST_COMPLETED).done:
                    job = running.pop(future)
                    codes[job.name] = future.result()
                    on_end(job, codes[job.name])
        except BaseException as error:
            pool.shutdown(wait=False, cancel_futures=True)
            if isinstance(error, KeyboardInterrupt):
                _end_twice(end, running)
            raise
    return codes


def _end_twice(end: Callable[[], None], running: Collection[Future[int]]) -> None:
    """Ends jobs, and ends them again, which they obey at once, if this process is interrupted again."""
    end()
    try:
        wait([future for future in running if not future.cancelled()])
    except KeyboardInterrupt:
        end()


def gpu_slots(jobs_per_gpu: int) -> list[dict[str, str]]:
    """Returns one slot per GPU and process on it; on a machine without a GPU, one per ``jobs_per_gpu``."""
    import torch

    visible = os.environ.get("CUDA_VISIBLE_DEVICES")
    names = visible.split(",") if visible else [str(index) for index in range(torch.cuda.device_count())]
    gpus = [{"CUDA_VISIBLE_DEVICES": name} for name in names] if torch.cuda.is_available() else [{}]
    return [slot for _ in range(jobs_per_gpu) for slot in gpus]


def _start(children: Children, job: Job, slot: Mapping[str, str], log_file: Path, at_once: int) -> int:
    """Runs one job as a process that writes to a log and ends with this one."""
    threads = max(1, num_cores() // at_once)
    environment = {"OMP_NUM_THREADS": str(threads)} | dict(os.environ) | dict(slot)
    with log_file.open("ab") as output:
        return children.run(job.program, output, environment)
