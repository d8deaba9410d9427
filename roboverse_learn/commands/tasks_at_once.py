"""Commands of several tasks, so many at once, before this process does the same for one task after the other.

A command ends at once where its work is done, so that this process finds the work of the others there. What
one of them could not do it tries again, and says why it fails.
"""

import itertools
import logging
import tempfile
from collections.abc import Mapping, Sequence
from dataclasses import replace
from pathlib import Path

from roboverse_learn.commands.words_of_config import collect_words, evaluate_words
from roboverse_learn.config.schema import CollectConfig, EvaluateConfig
from roboverse_learn.launch.base import Job, NoSettings
from roboverse_learn.launch.local import LocalLauncher

log = logging.getLogger(__name__)


def collect_ahead(configs: Sequence[CollectConfig]) -> None:
    """Completes the dataset of each configuration, as many at once as each of them says."""
    at_once = min((config.tasks_at_once for config in configs), default=1)
    if at_once > 1 and len(configs) > 1:
        _run(
            {each.env.task: ("collect", *collect_words(replace(each, tasks_at_once=1))) for each in configs},
            at_once,
        )


def evaluate_ahead(config: EvaluateConfig, tasks: Sequence[str]) -> None:
    """Evaluates in each task, as many at once as the configuration says."""
    if config.tasks_at_once > 1 and len(tasks) > 1:
        # What another benchmark's protocol changes is said by the other keys.
        alone = {"suite": "", "protocol": "", "tasks_at_once": 1}
        each = {task: replace(config, env={**config.env, "task": task}, **alone) for task in tasks}
        words = {task: ("evaluate", *evaluate_words(one)) for task, one in each.items()}
        _run(words, config.tasks_at_once)


def _run(commands: Mapping[str, tuple[str, ...]], at_once: int) -> None:
    """Runs the command of each task."""
    logs = Path(tempfile.mkdtemp(prefix="roboverse-"))
    log.info("%d tasks, each in a process. Their logs: %s", len(commands), logs)
    jobs = [Job(f"{words[0]}-{task}".replace("/", "-"), words) for task, words in commands.items()]
    ended = itertools.count(1)

    def on_end(job: Job, code: int | None) -> None:
        what = "done" if code == 0 else f"ended with code {code}, and is tried again"
        log.info("%d of %d: %s %s", next(ended), len(jobs), job.name, what)

    LocalLauncher(NoSettings(), min(at_once, len(jobs))).run(jobs, logs, on_end)
