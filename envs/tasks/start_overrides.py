"""Refuses changes of a scene that a task's initial states replace in every episode.

What a start replaces is found by drawing one: of the task, of the task in the changed scene, and of the task
with each of its parameters a little different. Nothing is declared by a task.
"""

import dataclasses
import math
from collections.abc import Iterator, Mapping
from numbers import Real
from typing import Any

import numpy as np
import torch

from envs.core.errors import ConfigError
from envs.scenario import ScenarioCfg
from envs.scenario.changes import difference
from envs.state import EntityState
from envs.tasks.base import Task
from envs.tasks.parameters import is_parameter

_FIELDS = {"pos": "pos", "rot": "rot", "default": "joint_pos"}
"""Key of a scene to the part of a state that replaces it."""

_STEP = 0.01
"""Relative change of a parameter that shows what depends on it."""

_Key = tuple[str, str, str]
"""``"robots"`` or ``"objects"``, name, and a part of :class:`~envs.state.EntityState`."""


def check_not_overridden(task: Task, other: Task, changes: Mapping[str, Any]) -> None:
    """Refuses changes of poses, joints and sizes that a task's start does not follow.

    Args:
        task: The task with its own scene.
        other: The task in the changed scene.
        changes: How the scenes differ; see :func:`envs.scenario.changes.difference`.

    Raises:
        ConfigError: A change has no effect, or leaves the start where it was. The message names the
            parameters of the task to use instead.
    """
    keys = list(_placed(task.scenario, changes))
    sizes = [key for key in _flat(changes) if ".geoms." in key and key.endswith(".size")]
    if not keys and not sizes:
        return
    before = _start(task)
    after = _start(other) if keys else {}
    for dotted, key in keys:
        if key in before and np.array_equal(before[key], after[key]):
            names = [name for name, _, moved in _varied(task, before) if key in moved]
            raise _refusal(
                task, dotted, f"its start sets the {_WORDS[key[2]]} of '{key[1]}' in every episode", names
            )
    for dotted in sizes:
        names = [name for name, scene, moved in _varied(task, before) if moved and dotted in _flat(scene)]
        if names:
            raise _refusal(task, dotted, "its start and its rule would not follow", names)


_WORDS = {"pos": "position", "rot": "orientation", "joint_pos": "joints"}


def _refusal(task: Task, dotted: str, why: str, names: list[str]) -> ConfigError:
    if names:
        keys = " or ".join(f"task_kwargs.{name}=…" for name in names)
        what = f"Give {keys} instead, which scene, start and success rule follow."
    else:
        what = f"{task.name} has no parameter for it: leave the key out, or write a task of your own."
    return ConfigError(f"scenario.{dotted} cannot be changed for {task.name}: {why}. {what}")


def _placed(scene: ScenarioCfg, changes: Mapping[str, Any]) -> Iterator[tuple[str, _Key]]:
    """Yields the dotted keys of poses and rest positions that a start may replace."""
    bolted = {robot.name for robot in scene.robots if robot.fixed_base}
    for dotted in _flat(changes):
        kind, _, rest = dotted.partition(".")
        name, _, inner = rest.partition(".")
        part = inner.rpartition(".")[2]
        if kind not in ("robots", "objects") or part not in _FIELDS:
            continue
        if part == "default" or (inner == part and name not in bolted):
            yield dotted, (kind, name, _FIELDS[part])


def _flat(changes: Mapping[str, Any], prefix: str = "") -> list[str]:
    """Returns the dotted key of every change."""
    keys: list[str] = []
    for name, value in changes.items():
        key = f"{prefix}{name}"
        keys += _flat(value, f"{key}.") if isinstance(value, Mapping) else [key]
    return keys


def _start(task: Task) -> dict[_Key, np.ndarray]:
    """Returns the parts of an initial state; the same random numbers are drawn in every call."""
    state = task.initial_state([np.random.default_rng(0)])
    return {
        (kind, name, part): _array(getattr(entity, part))
        for kind in ("robots", "objects")
        for name, entity in _entities(state, kind)
        for part in _FIELDS.values()
    }


def _entities(state: Any, kind: str) -> Iterator[tuple[str, EntityState]]:
    yield from getattr(state, kind).items()


def _array(values: Any) -> np.ndarray:
    return torch.as_tensor(values).detach().cpu().numpy()


def _varied(task: Task, before: Mapping[_Key, np.ndarray]) -> Iterator[tuple[str, dict[str, Any], set[_Key]]]:
    """Yields each parameter with what of the scene and of the start changes with it."""
    for item in dataclasses.fields(task):  # pyright: ignore[reportArgumentType]
        if not item.init or not is_parameter(item):
            continue
        other = _with_another_value(task, item.name)
        if other is not None:
            after = _start(other)
            moved = {key for key in before if key in after and not np.array_equal(before[key], after[key])}
            yield item.name, difference(task.scenario, other.scenario), moved


def _with_another_value(task: Task, name: str) -> Task | None:
    """Returns the task with a parameter a little larger, or smaller; None where neither is allowed."""
    value = getattr(task, name)
    for step in (1.0 + _STEP, 1.0 - _STEP):
        try:
            return dataclasses.replace(task, **{name: _scaled(value, step)})  # type: ignore[type-var]
        except (ConfigError, TypeError):
            continue
    return None


def _scaled(value: Any, step: float) -> Any:
    if isinstance(value, tuple | list):
        return tuple(_scaled(item, step) for item in value)
    if isinstance(value, bool) or not isinstance(value, Real):
        raise TypeError(value)
    return math.copysign(_STEP, step - 1.0) if value == 0 else float(value) * step
