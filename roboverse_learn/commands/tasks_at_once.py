"""Runs the commands of several tasks in parallel processes.

Afterwards this process does the same work task by task: it finds what is done, and repeats what failed. So
datasets and results are those of the command that was given, whatever did their episodes.
"""

import gc
import itertools
import logging
import os
import shutil
import sys
import tempfile
from collections.abc import Mapping, Sequence
from dataclasses import replace
from pathlib import Path

from envs.core.machine import num_cores
from envs.simulators import HANDLERS
from roboverse_learn.commands.words_of_config import collect_words, evaluate_words
from roboverse_learn.config.schema import CollectConfig, EvaluateConfig
from roboverse_learn.launch.base import Job
from roboverse_learn.launch.local import gpu_slots, run_processes

log = logging.getLogger(__name__)

_ONLY_CELLS = "ROBOVERSE_ONLY_CELLS"
"""Environment variable of processes that leave the results file to the one that started them."""


def keeps_cells_alone() -> bool:
    """Whether an evaluation of this process ends with its cells, without a results file."""
    return bool(os.environ.get(_ONLY_CELLS))


def collect_in_parallel(configs: Sequence[CollectConfig]) -> None:
    """Completes the datasets of tasks in processes beside each other."""
    at_once = min([len(configs), *(config.tasks_at_once for config in configs)])
    if at_once <= 1:
        return
    commands = {}
    for config in configs:
        collect = config.collect
        if not collect.num_workers and not HANDLERS.get(config.env.simulator).steps_together:
            collect = replace(collect, num_workers=max(1, num_cores() // at_once))
        one = replace(config, collect=collect, tasks_at_once=1)
        commands[config.env.task] = ("collect", *collect_words(one))
    _run(commands, gpu_slots(at_once)[:at_once])


def evaluate_in_parallel(config: EvaluateConfig, tasks: Sequence[str]) -> None:
    """Evaluates the cells of tasks in processes beside each other."""
    at_once = min(config.tasks_at_once, len(tasks))
    if at_once <= 1:
        return
    # What another benchmark's protocol changes is said by the other keys.
    alone = {"suite": "", "protocol": "", "tasks_at_once": 1}
    each = {task: replace(config, env={**config.env, "task": task}, **alone) for task in tasks}
    named = config.device == "cpu" or ":" in config.device  # no other GPU is wanted
    slots = [{}] * at_once if named else gpu_slots(at_once)[:at_once]
    commands = {task: ("evaluate", *evaluate_words(one)) for task, one in each.items()}
    _free_gpu_memory()
    _run(commands, [{**slot, _ONLY_CELLS: "1"} for slot in slots])


def _free_gpu_memory() -> None:
    """Gives back what training kept for itself, which other processes need."""
    if torch := sys.modules.get("torch"):
        gc.collect()
        torch.cuda.empty_cache()  # does nothing where no GPU was used


def _run(commands: Mapping[str, tuple[str, ...]], slots: Sequence[Mapping[str, str]]) -> None:
    """Runs the command of each task, one in each slot at a time; logs stay where one failed."""
    logs = Path(tempfile.mkdtemp(prefix="roboverse-"))
    log.info("%d tasks, each in a process. Their logs, until all have succeeded: %s", len(commands), logs)
    jobs = [
        Job(f"{number}-{words[0]}-{task}".replace("/", "-"), words)
        for number, (task, words) in enumerate(commands.items(), start=1)
    ]
    ended = itertools.count(1)

    def on_end(job: Job, code: int | None) -> None:
        number = next(ended)
        if code == 0:
            log.info("%d of %d: %s done", number, len(jobs), job.name)
        else:
            said = "%d of %d: %s ended with code %s; it is tried again below."
            log.warning(said, number, len(jobs), job.name, code)

    codes = run_processes(jobs, slots, logs, on_end)
    if not any(codes.values()):
        shutil.rmtree(logs, ignore_errors=True)
