"""A task by its name, with its options, and with its scene changed."""

from collections.abc import Mapping
from dataclasses import fields
from types import NoneType, UnionType
from typing import Any, Union, get_args, get_origin

from envs.core.errors import unknown_name
from envs.scenario import ScenarioCfg
from envs.scenario.changes import changed, difference, typed_value
from envs.tasks import TASKS
from envs.tasks.base import Task
from envs.tasks.start_overrides import check_not_overridden


def make_task(
    name: str, options: Mapping[str, Any] | None = None, scenario: Mapping[str, Any] | None = None
) -> Task:
    """Makes a task.

    Args:
        name: Registered name.
        options: Values of its fields, as the command line or JSON has them: a list may stand for a tuple.
        scenario: What is changed of its scene; see :func:`envs.scenario.changes.changed`. Its controllers
            and its expert know the changed one: at another control rate an expert moves as fast as before.

    Raises:
        ConfigError: if a value is none that an option, or a part of the scene, may have, or if the task's
            initial states replace the part.
        UnknownNameError: if no task has that name or option, or its scene no such part.
    """
    cls = TASKS.get(name)
    typed = _typed(cls, name, options or {})
    task = cls(**typed)
    if not scenario:
        return task
    own = task.scenario
    other = _with_scenario(cls, typed, changed(own, scenario))
    check_not_overridden(task, other, difference(own, other.scenario))
    return other


def _typed(cls: type[Task], name: str, options: Mapping[str, Any]) -> dict[str, Any]:
    """Returns the values of a task's fields, each of the type of its field."""
    if not options:
        return {}
    types = {item.name: item.type for item in fields(cls)}  # pyright: ignore[reportArgumentType]
    for key in options:
        if key not in types:
            raise unknown_name(f"option of {name}", str(key), types)
    return {
        key: typed_value(value, types[key], f"task_kwargs.{key}") if _is_numeric(types[key]) else value
        for key, value in options.items()
    }


def _is_numeric(hint: Any) -> bool:
    """Whether a type is a number, several of them, or none; choices and texts are checked by the task."""
    if hint in (float, int, NoneType, Ellipsis):
        return True
    return get_origin(hint) in (tuple, UnionType, Union) and all(map(_is_numeric, get_args(hint)))


def _with_scenario(cls: type[Task], options: Mapping[str, Any], scenario: ScenarioCfg) -> Task:
    """Makes a task that has another scene: of a class of its own, for a scene is a property."""
    body = {
        "scenario": property(lambda _: scenario),
        "robot": property(lambda _: scenario.robots[0]),
        "__doc__": cls.__doc__,
        "__slots__": (),
    }
    return type(cls.__name__, (cls,), body)(**options)
