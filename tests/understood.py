"""Commands as they are typed, understood as far as that goes without running them."""

from collections.abc import Sequence

import policies
from roboverse_learn import sweep
from roboverse_learn.commands.collected import of_task
from roboverse_learn.commands.dataset_layout import task_layout
from roboverse_learn.config.compose import compose
from roboverse_learn.config.schema import COMMANDS, TrainRunConfig


def understand(name: str, words: Sequence[str]) -> None:
    """Composes a command; tasks of demonstrations must have the cameras that it names.

    Args:
        name: Of a command of ``roboverse``.
        words: Its words ``key=value``.

    Raises:
        RoboVerseError: The command would refuse them.
    """
    if name not in COMMANDS or not words:
        return
    if name == "sweep":
        sweep.plan(words)
        return
    config = compose(name, words)
    if name == "collect" and not config.suite and config.source == "expert":
        task_layout(config)
    if not isinstance(config, TrainRunConfig) or config.dataset or config.run:
        return
    if policies.learns_from(config.policy_name) == "dataset":
        for task in config.tasks:
            task_layout(of_task(config, task))
