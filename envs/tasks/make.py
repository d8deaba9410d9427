"""A task by its name, with its options, and with its scene changed."""

from collections.abc import Mapping
from dataclasses import fields, replace
from types import NoneType, UnionType
from typing import Any, Union, get_args, get_origin

from envs.core.errors import ConfigError, unknown_name
from envs.robots import ROBOTS
from envs.scenario import ScenarioCfg
from envs.scenario.changes import changed, difference, typed_value
from envs.tasks import TASKS
from envs.tasks.base import Task
from envs.tasks.hand_space import check_space, chosen_space, space_parts
from envs.tasks.start_overrides import check_not_overridden


def make_task(
    name: str,
    options: Mapping[str, Any] | None = None,
    scenario: Mapping[str, Any] | None = None,
    robot: str = "",
) -> Task:
    """Makes a task.

    Args:
        name: Registered name.
        options: Values of its fields, as the command line or JSON has them: a list may stand for a tuple.
            ``action_space`` is one of those of :mod:`envs.tasks.hand_space`.
        scenario: What is changed of its scene; see :func:`envs.scenario.changes.changed`. Its controllers
            and its expert know the changed one: at another control rate an expert moves as fast as before.
        robot: Registered robot that does the task in place of its own; see :mod:`envs.tasks.fit_robot`.
            Changes of the scene come after it.

    Raises:
        ConfigError: if a value is none that an option, or a part of the scene, may have, or if the task's
            initial states replace the part, or if the robot cannot do the task.
        UnknownNameError: if no task or robot has that name, the task no such option, or its scene no such
            part.
    """
    cls, given = TASKS.get(name), dict(options or {})
    space = chosen_space(cls, given)
    if space is not None:
        del given["action_space"]
    typed = _typed(cls, name, given)
    task = cls(**typed)
    if space is not None and space != "joints":
        check_space(task, space)
        task = _subclass(cls, space_parts(cls, space))(**typed)
    if robot:
        task = _with_robot(task, typed, robot)
    if not scenario:
        return task
    own = task.scenario
    other = _with_scenario(type(task), typed, changed(own, scenario))
    check_not_overridden(task, other, difference(own, other.scenario))
    return other


def in_scene(task: Task, scenario: ScenarioCfg) -> Task:
    """Returns a task that takes place in another scene, which holds at least all of its own."""
    values = {item.name: getattr(task, item.name) for item in fields(task) if item.init}  # pyright: ignore[reportArgumentType]
    return _with_scenario(type(task), values, scenario)


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


def _with_robot(task: Task, options: Mapping[str, Any], name: str) -> Task:
    """Makes a task that another robot does; the task itself where it is its own.

    Raises:
        ConfigError: if the robot cannot, or if the task's scene names its own.
    """
    cls, own, robot = type(task), task.robot, ROBOTS.get(name)
    if robot.name == own.name:
        return task
    from envs.tasks.fit_robot import check_arm, fitted

    task.only_robot("robot=")
    check_arm(task, robot)
    if not own.gripper_joints or not own.fixed_base:
        raise ConfigError(
            f"{task.name} has a robot of its own, '{own.name}', and takes no other: that is no arm with a "
            "gripper."
        )
    if "native" in (getattr(task, "action_space", ""), getattr(task, "observation_space", "")):
        raise ConfigError(
            f"{task.name} with native actions or observations has a robot of its own, '{own.name}', and "
            "takes no other."
        )
    there = replace(robot, pos=own.pos, rot=own.rot)  # a scene may build what its robot stands on
    if _subclass(cls, {"robot": property(lambda _: there)})(**options).scenario.robots[0] != there:
        raise ConfigError(
            f"{task.name} has a robot of its own, '{own.name}', and takes no other. A task takes any "
            "robot where its scene, start and rules use self.robot."
        )
    placed = fitted(task, robot)
    return _subclass(cls, {"robot": property(lambda _: placed)})(**options)


def _with_scenario(cls: type[Task], options: Mapping[str, Any], scenario: ScenarioCfg) -> Task:
    """Makes a task that has another scene: of a class of its own, for a scene is a property."""
    acting = {robot.name for robot in cls(**options).robots}
    robots = tuple(robot for robot in scenario.robots if robot.name in acting)
    parts = {
        "scenario": property(lambda _: scenario),
        "robot": property(lambda _: robots[0]),
        "robots": property(lambda _: robots),
    }
    return _subclass(cls, parts)(**options)


def _subclass(cls: type[Task], parts: Mapping[str, Any]) -> type[Task]:
    return type(cls.__name__, (cls,), {**parts, "__doc__": cls.__doc__, "__slots__": ()})
