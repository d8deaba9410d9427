"""A task by its name, with its options, and with its scene changed."""

from collections.abc import Mapping
from typing import Any

from envs.scenario import ScenarioCfg
from envs.scenario.changes import changed
from envs.tasks import TASKS
from envs.tasks.base import Task


def make_task(
    name: str, options: Mapping[str, Any] | None = None, scenario: Mapping[str, Any] | None = None
) -> Task:
    """Makes a task.

    Args:
        name: Registered name.
        options: Values of its fields.
        scenario: What is changed of its scene; see :func:`envs.scenario.changes.changed`. Its controllers
            and its expert know the changed one: at another control rate an expert moves as fast as before.

    Raises:
        ConfigError: if a value is none that an option, or a part of the scene, may have.
        UnknownNameError: if no task has that name, or its scene no such part.
    """
    cls = TASKS.get(name)
    task = cls(**(options or {}))
    return _with_scenario(cls, options or {}, changed(task.scenario, scenario)) if scenario else task


def _with_scenario(cls: type[Task], options: Mapping[str, Any], scenario: ScenarioCfg) -> Task:
    """Makes a task that has another scene: of a class of its own, for a scene is a property."""
    body = {"scenario": property(lambda _: scenario), "__doc__": cls.__doc__, "__slots__": ()}
    return type(cls.__name__, (cls,), body)(**options)
