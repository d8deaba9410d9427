"""``collect``, ``train``, ``evaluate`` and ``check`` as functions; their arguments are the settings.

A setting has the name that it has on the command line. One with dots is a dictionary, or is named by its last
part where no other ends so: ``train(steps=5)``, ``train(train={"steps": 5})``.
"""

import logging
from collections.abc import Callable, Mapping, Sequence
from dataclasses import fields
from pathlib import Path
from typing import TYPE_CHECKING, Any, Literal

from envs.core.errors import ConfigError
from envs.core.json_values import flat, to_json_values
from envs.tasks import TASKS
from envs.tasks.base import Task
from policies.base import Observation, Policy, listed
from roboverse_learn.commands.called_with import called_with
from roboverse_learn.commands.outcomes import Evaluation, TrainedRun
from roboverse_learn.config.command_line_keys import MAPS
from roboverse_learn.config.compose import compose
from roboverse_learn.config.value_text import as_text
from roboverse_learn.evaluate import evaluate_all, evaluate_policy

if TYPE_CHECKING:
    import numpy as np

    from roboverse_learn.checks.report import Checked
    from roboverse_learn.data.collection.collect import CollectionSummary

log = logging.getLogger(__name__)

type AnyPolicy = Policy | Callable[[Observation], "np.ndarray"]


def collect(task: "str | Task | type[Task]" = "PickCube", **settings: Any) -> "CollectionSummary":
    """Collects demonstrations as a LeRobotDataset; called again, it continues.

    Args:
        task: Name of a task, a task, or its class.
        **settings: Those of ``roboverse collect``, such as ``num_demos=50``.

    Returns:
        What was collected; ``root`` is the dataset's folder.

    Raises:
        ConfigError: A suite is given, which has a dataset for each task.
        RoboVerseError: as :func:`roboverse_learn.collect.collect`.
    """
    from roboverse_learn.collect import collect_dataset

    if settings.get("suite"):
        raise ConfigError(
            f"collect() returns one dataset, and suite={settings['suite']!r} has one for each task: call it "
            "for each of envs.tasks.suites.suite_tasks(name), or run roboverse collect suite=<name>."
        )
    return collect_dataset(compose("collect", (), _of_task(task, in_one_process=True) | settings))


def train(
    policy: str = "act", task: "str | Task | type[Task]" = "PickCube", **settings: Any
) -> TrainedRun | None:
    """Runs the whole loop: collects what is missing, trains, evaluates and writes the leaderboard.

    Called again with the same settings, it continues where it stopped.

    Args:
        policy: Name of a policy.
        task: Name of a task, a task, or its class.
        **settings: Those of ``roboverse train``, such as ``preset="quick"``.

    Returns:
        The run with its checkpoint and evaluations, and in ``board_failure`` why no leaderboard could be
        written, which is logged as well; None in other processes than the first of
        ``accelerate launch``.

    Raises:
        RoboVerseError: as :func:`roboverse_learn.train.train_run`.
    """
    from roboverse_learn.train import train_run

    given = {"policy": policy} | _of_task(task, in_one_process=True) | settings
    with called_with(_words(given)):
        run = train_run(compose("train", (), given))
    if run is not None and run.board_failure:
        log.warning("%s", run.board_failure)
    return run


def evaluate(
    policy: "str | Path | AnyPolicy | None" = None,
    task: "str | Task | type[Task] | Sequence[str] | None" = None,
    *,
    actions: Literal["task", "rl"] = "task",
    **settings: Any,
) -> list[Evaluation]:
    """Evaluates a policy over levels and splits.

    Args:
        policy: Folder of a checkpoint or of a run, a baseline such as ``"random"`` or ``"expert"``, a
            :class:`~policies.base.Policy`, or a function: it takes the observations of n environments, a
            dictionary of arrays (n, …), and returns actions (n, action_dim) or chunks of them
            (n, T, action_dim). It gets images where ``cameras`` is given, and the state of all objects
            (``observation.environment_state``) otherwise. None where ``checkpoint=`` names the folder, as on
            the command line.
        task: Name of a task, names of several, a task, or its class; None takes those that the checkpoint
            learned.
        actions: What the actions of a function mean: ``task`` for the task's controller, ``rl`` for that of
            reinforcement learning.
        **settings: Those of ``roboverse evaluate``, such as ``levels=[0, 3]`` or ``episodes=20``.

    Returns:
        One evaluation per task, of which a list or ``suite="paper"`` names several. Checkpoints and baselines
        have a results file; functions have none, since nobody could repeat it.

    Raises:
        ConfigError: Neither a policy nor a checkpoint is given, or both are.
        RoboVerseError: as :func:`roboverse_learn.evaluate.evaluate_all`.
    """
    given = ({} if task is None else _of_task(task)) | settings
    if policy is not None and given.get("checkpoint"):
        raise ConfigError(
            f"A policy and checkpoint={given['checkpoint']} are both given: which of them is evaluated? "
            "Leave one out."
        )
    if policy is None or isinstance(policy, str | Path):
        from roboverse_learn.config.schema import baselines

        if policy is not None:
            given |= {"policy" if policy in baselines() else "checkpoint": str(policy)}
        with called_with(_words(given)):
            return evaluate_all(compose("evaluate", (), given))
    if task is None:
        raise ConfigError("A policy that is no checkpoint needs a task, as in evaluate(policy, 'PickCube').")
    acting: Any = policy
    if not isinstance(policy, Policy):
        from policies.function import FunctionPolicy

        if not callable(policy):
            raise ConfigError(
                f"'{policy}' is no policy. Give the folder of a checkpoint, the name of a baseline, a "
                "Policy, or a function of observations that returns actions."
            )
        acting = FunctionPolicy(policy, actions)
    # The words of a baseline, so that the same keys are valid and have the same defaults.
    config = compose("evaluate", (), {"policy": "random"} | given)
    with called_with(_words(given)):
        return evaluate_policy(acting, config)


def check(task: "str | Task | type[Task]" = "PickCube", **settings: Any) -> "Checked":
    """Looks at the contracts of a task, or of the ``policy=`` or ``robot=`` that is named.

    Args:
        task: Name of a task, a task, or its class.
        **settings: Those of ``roboverse check``, such as ``episodes=5``.

    Returns:
        What was found; ``ok`` says whether no contract is broken, and ``failures`` which ones are.

    Raises:
        RoboVerseError: as :func:`roboverse_learn.check.check`.
    """
    from roboverse_learn.check import check as check_contracts

    return check_contracts(compose("check", (), _of_task(task) | settings))


def _of_task(
    task: "str | Task | type[Task] | Sequence[str]", *, in_one_process: bool = False
) -> dict[str, Any]:
    """Returns the settings of a task, which is registered for this process where it is not.

    Raises:
        ConfigError: Another task has its name.
    """
    if isinstance(task, str):
        return {"task": task}
    if isinstance(task, Sequence):
        return {"task": listed(task)}
    cls = task if isinstance(task, type) else type(task)
    settings: dict[str, Any] = {"task": cls.name}
    if cls.name not in TASKS:
        TASKS.add(cls.name, cls)
        _IN_THIS_PROCESS.add(cls.name)
    elif TASKS.get(cls.name) is not cls:
        raise ConfigError(
            f"The task '{cls.name}' is registered already, as another class. Give {cls.__qualname__} another "
            "name."
        )
    if in_one_process and cls.name in _IN_THIS_PROCESS:  # other processes do not know it
        settings["collect"] = {"num_workers": 1}
    if not isinstance(task, type):
        options = {item.name: getattr(task, item.name) for item in fields(task) if item.init}  # pyright: ignore[reportArgumentType]
        settings["task_kwargs"] = {
            item.name: options[item.name]
            for item in fields(task)  # pyright: ignore[reportArgumentType]
            if item.name in options and options[item.name] != item.default
        }
    return settings


_IN_THIS_PROCESS: set[str] = set()
"""Tasks that were given as classes and are registered nowhere else."""


def _words(given: Mapping[str, Any]) -> list[str]:
    """Returns settings as the words that a result's command shows."""
    return [f"{key}={as_text(to_json_values(value))}" for key, value in flat(given, leaves=MAPS).items()]
