"""A command's configuration as nested plain values, as a command line and a saved run have it, and back.

Pydantic checks the types of the values (OmegaConf's structured configs have no ``Literal`` and no fixed
tuples), the dataclasses their ranges, and the registries their names. The fields of ``env`` are at the top
level: ``task``, not ``env.task``.
"""

import dataclasses
import importlib
from collections.abc import Iterable, Mapping
from functools import cache
from typing import Any

import policies
from envs.core.errors import ConfigError, wrong_value
from envs.core.json_values import to_json_values
from envs.randomization.levels import unknown_level
from envs.simulators.settings import check_settings
from envs.spec import EnvSpec
from envs.tasks.protocols import check_protocol
from policies.base import listed
from roboverse_learn.config.command_line_keys import flat_keys, unknown_key
from roboverse_learn.config.scenario_overrides import checked_scenario
from roboverse_learn.config.schema import COMMANDS, EVALUATE_ENV_KEYS, NAMES_A_POLICY


def from_values(command: str, values: Mapping[str, Any]) -> Any:
    """Builds the configuration of a command from nested plain values, such as a saved configuration.

    Raises:
        UnknownNameError: A key or a registered name does not exist.
        ConfigError: A value is of the wrong type or out of range.
    """
    from pydantic import ValidationError

    policy = values.get("policy_name", "act") if command not in NAMES_A_POLICY else ""
    known = flat_keys(default_values(command, policy))
    unknown = sorted(set(flat_keys(values)) - set(known))
    if unknown:
        raise unknown_key(command, unknown[0], known)
    own = dict(values)
    env = {key: own.pop(key) for key in env_keys(command) if key in own}
    for task in task_names(env["task"]) if own.get("protocol") and env.get("task") else ():
        check_protocol(own["protocol"], task)
    try:
        if env_keys(command):
            own["env"] = _environment_of_tasks(command, env, checks_task=not own.get("suite"))
        if "policy" in own:
            own["policy"] = _adapter(policies.config_class(policy)).validate_python(own["policy"])
        config = _adapter(COMMANDS[command]).validate_python(own)
    except ValidationError as error:
        of_policy = "policy" in own and error.title == policies.config_class(policy).__name__
        raise _readable(error, "policy." if of_policy else "") from error
    _check_names("task", getattr(config, "tasks", ()))
    for task in getattr(config, "tasks", ())[1:] if env.get("task_kwargs") else ():
        _check_same_options(config.env, task, env["task_kwargs"])
    _check_names("simulator", getattr(config, "simulators", ()))
    if hasattr(config, "simulator"):
        _check_names("simulator", [config.simulator])
    return config


def to_values(config: Any) -> dict[str, Any]:
    """Returns a configuration as nested plain JSON values, which :func:`from_values` takes."""
    values = to_json_values(config)
    return values.pop("env", {}) | values


def env_keys(command: str) -> tuple[str, ...]:
    """Returns the keys of a command that are fields of its environment."""
    if command == "evaluate":
        return EVALUATE_ENV_KEYS
    return tuple(EnvSpec.__dataclass_fields__) if "env" in COMMANDS[command].__dataclass_fields__ else ()


def default_values(command: str, policy: str = "act") -> dict[str, Any]:
    """Returns the defaults of a command's dataclass as nested plain values.

    For ``evaluate``, an empty value of an environment's field means the checkpoint's own.
    """
    env = to_json_values(EnvSpec())
    values = {key: type(env[key])() if command == "evaluate" else env[key] for key in env_keys(command)}
    for item in dataclasses.fields(COMMANDS[command]):
        if item.name == "policy":
            values["policy"] = to_json_values(policies.config_class(policy)())
        elif item.name == "policy_name" and command not in NAMES_A_POLICY:
            values["policy_name"] = policy
        elif item.name != "env":
            made = item.default if item.default_factory is dataclasses.MISSING else item.default_factory()
            values[item.name] = to_json_values(made)
    return values


def task_names(given: Any) -> list[str]:
    """Returns the tasks of ``task=``: one, or a list as it is typed or as a program has it.

    Raises:
        ConfigError: It is a list without its brackets.
    """
    if not isinstance(given, str):
        names = given
    elif given.startswith("[") and given.endswith("]"):
        names = given[1:-1].split(",")
    elif "," in given:
        raise ConfigError(f"task={given} has no brackets. Write several tasks as a list: task=[{given}].")
    else:
        return [given]
    return [str(name).strip() for name in names] or [""]


def _environment_of_tasks(command: str, values: dict[str, Any], *, checks_task: bool) -> Any:
    """Returns :func:`_environment`; for ``evaluate`` of a list of tasks, checked with each of them."""
    names = list(dict.fromkeys(task_names(values.get("task", "")))) if command == "evaluate" else [""]
    if names == [""]:
        return _environment(command, values, checks_task=checks_task)
    _check_names("task", names)
    each = [_environment(command, values | {"task": name}, checks_task=checks_task) for name in names]
    return each[0] if len(names) == 1 else each[0] | {"task": listed(names)}


def _environment(command: str, values: dict[str, Any], *, checks_task: bool = True) -> Any:
    """Returns the checked environment of plain values; for ``evaluate``, a mapping of the given fields.

    Options and changes of the scene are checked by the task; with a suite, later and for each of its tasks.
    """
    partial = command == "evaluate"
    if partial:
        values = {key: value for key, value in values.items() if value}
    spec = _adapter(EnvSpec).validate_python(values)
    given = values if partial else to_json_values(spec)
    if not spec.task or not checks_task:  # a robot by itself, or any task of a suite
        given = {key: value for key, value in given.items() if key != "task"}
    for kind in ("task", "simulator", "renderer"):
        _check_names(kind, [given[kind]] if kind in given else [])
    if "simulator" in given:
        check_settings(spec.simulator, spec.simulator_settings)
    scenario, options, robot = {}, {}, spec.robot
    if "task" in given:
        options = _checked_options(spec)
        robot = _checked_robot(spec)
        scenario = checked_scenario(spec.task, spec.task_kwargs, spec.scenario, robot=robot)
    elif robot:
        _check_names("robot", [robot])
    if partial:  # not shortened: a change back to the task's own value counts after training with another
        return {key: getattr(spec, key) for key in given}
    return spec.replace(scenario=scenario, task_kwargs=options, robot=robot) if checks_task else spec


def _check_names(kind: str, names: Iterable[str]) -> None:
    """Checks names of tasks, robots, simulators or renderers; another simulator can be a renderer."""
    simulators = importlib.import_module("envs.simulators")
    registries = {
        "task": importlib.import_module("envs.tasks").TASKS,
        "simulator": simulators.HANDLERS,
        "robot": importlib.import_module("envs.robots").ROBOTS,
        "renderer": simulators.RENDERERS,
    }
    own = registries[kind]
    further = simulators.HANDLERS.names() if kind == "renderer" else ()
    valid = {*own.names(), *further}
    for name in names:
        if kind == "task" and "," in name:
            raise ConfigError(f"task={name} names several tasks, and one is taken here. Give one of them.")
        if name not in valid:
            raise own.unknown(name, further=further)


def _checked_options(spec: EnvSpec) -> dict[str, Any]:
    """Checks the options of a task; returns those that differ from its defaults."""
    if not spec.task_kwargs:
        return {}
    task = spec.replace(scenario={}, robot="").make_task()  # it checks the values
    defaults = {item.name: item.default for item in dataclasses.fields(task)}  # pyright: ignore[reportArgumentType]
    defaults.setdefault("action_space", "joints")  # of every task that has none of its own
    values = {key: getattr(task, key, defaults[key]) for key in spec.task_kwargs}
    return {key: to_json_values(value) for key, value in values.items() if value != defaults[key]}


def _check_same_options(spec: EnvSpec, other: str, given: Mapping[str, Any]) -> None:
    """Checks that options mean the same to a task that is learned together with another one.

    Args:
        spec: The environment of the first task, with its checked options: those that are not its defaults.
        other: The other task.
        given: The options as they were given.

    Raises:
        UnknownNameError: It has no such option.
        ConfigError: A value is out of its range, or the default of one of the two alone.
    """
    options = _checked_options(spec.replace(task=other, task_kwargs=given))
    if options != spec.task_kwargs:
        key = next(k for k in given if options.get(k) != spec.task_kwargs.get(k))
        own, without = (other, spec.task) if key in spec.task_kwargs else (spec.task, other)
        raise ConfigError(
            f"task_kwargs.{key}={given[key]} is the default of {own} and not of {without}, and tasks that "
            "are learned together have one value. Leave it out, or train each task by itself."
        )


def _checked_robot(spec: EnvSpec) -> str:
    """Checks that a robot can do the task; returns its name, or none for the task's own."""
    if not spec.robot:
        return ""
    _check_names("robot", [spec.robot])
    own = spec.replace(scenario={}, robot="").make_task().robot.name
    other = spec.replace(scenario={}).make_task().robot.name
    return "" if other == own else spec.robot


@cache
def _adapter(settings: type) -> Any:
    """Returns the checker of a dataclass; making one takes longer than using it."""
    from pydantic import TypeAdapter

    return TypeAdapter(settings)


def _readable(error: Any, prefix: str) -> ConfigError:
    """Returns pydantic's ValidationError as one sentence for each wrong value."""
    lines = []
    for item in error.errors():
        cause = item.get("ctx", {}).get("error")
        if isinstance(cause, Exception):  # a check of the dataclass, whose message is complete
            lines.append(str(cause))
        else:
            lines.append(_of_level(item) or f"{prefix}{'.'.join(map(str, item['loc']))}: {wrong_value(item)}")
    return ConfigError(" ".join(dict.fromkeys(lines)))


def _of_level(item: Mapping[str, Any]) -> str:
    """Returns the message for a level that is no number, or nothing where the value is no level."""
    if not item["type"].startswith("int_"):
        return ""
    if item["loc"][-1] == "level":
        return str(unknown_level(item["input"]))
    return str(unknown_level(item["input"], "alone=[{}]")) if item["loc"][-2:-1] == ("levels",) else ""
