"""A command's configuration and its plain values: what a saved configuration and a command line have.

Pydantic checks the kinds of the values, the dataclasses their ranges, the registries their names.
"""

import dataclasses
import importlib
from collections.abc import Mapping
from functools import cache
from typing import Any

import policies
from envs.core.errors import ConfigError, unknown_name, wrong_value
from envs.core.plain_values import plain
from envs.simulators.settings import check_settings
from envs.spec import EnvSpec
from roboverse_learn.config.keys import flat_keys, unknown_key
from roboverse_learn.config.scenario_overrides import checked_scenario
from roboverse_learn.config.schema import (
    EVALUATE_ENV_KEYS,
    CollectConfig,
    ConservationConfig,
    ConvertConfig,
    EvaluateConfig,
    LeaderboardConfig,
    ReplayConfig,
    SweepConfig,
    TrainRunConfig,
)

COMMANDS: dict[str, type] = {
    "collect": CollectConfig,
    "train": TrainRunConfig,
    "sweep": SweepConfig,
    "evaluate": EvaluateConfig,
    "leaderboard": LeaderboardConfig,
    "convert": ConvertConfig,
    "replay": ReplayConfig,
    "conservation": ConservationConfig,
}
"""Every command that takes ``key=value`` words, and what it can be told."""


def from_values(command: str, values: Mapping[str, Any]) -> Any:
    """Builds the configuration of a command from nested plain values, such as a saved configuration.

    Raises:
        UnknownNameError: A name is not registered.
        ConfigError: A key is unknown or missing its type, or a value is out of range.
    """
    from pydantic import ValidationError

    policy_name = values.get("policy_name", "act")
    defaults = default_values(command, policy_name)
    unknown = sorted(set(flat_keys(values)) - set(flat_keys(defaults)))
    if unknown:
        raise unknown_key(command, unknown[0], flat_keys(defaults))
    plain = dict(values)
    try:
        if env_keys(command):
            plain["env"] = _environment(
                command, {key: plain.pop(key) for key in env_keys(command) if key in plain}
            )
        if "policy" in plain:
            plain["policy"] = _adapter(policy_config(policy_name)).validate_python(plain["policy"])
        config = _adapter(COMMANDS[command]).validate_python(plain)
    except ValidationError as error:
        raise _readable(error, policy_name if "policy" in plain else None) from error
    _check_lists(config)
    return config


def to_values(config: Any) -> dict[str, Any]:
    """Returns a configuration as nested plain JSON values, which :func:`from_values` reads back.

    The fields of ``env`` are at the top level, where a command line has them.
    """
    values = plain(config)
    env = values.pop("env", {})
    return env | values


def env_keys(command: str) -> tuple[str, ...]:
    """Returns the keys of a command that are fields of its environment."""
    cls = COMMANDS[command]
    if cls is EvaluateConfig:
        return EVALUATE_ENV_KEYS
    return tuple(EnvSpec.__dataclass_fields__) if "env" in cls.__dataclass_fields__ else ()


def default_values(command: str, policy: str = "act") -> dict[str, Any]:
    """Returns the dataclasses' defaults of a command, nested; the fields of ``env`` are at the top level.

    For ``evaluate``, an empty value of an environment's field stands for the checkpoint's own.
    """
    env = plain(EnvSpec())
    values = {key: env[key] if command != "evaluate" else type(env[key])() for key in env_keys(command)}
    for item in dataclasses.fields(COMMANDS[command]):
        if item.name == "env":
            continue
        if item.name == "policy":
            values["policy"] = plain(policy_config(policy)())
        elif item.name == "policy_name":
            values["policy_name"] = policy
        elif item.default_factory is not dataclasses.MISSING:
            values[item.name] = plain(item.default_factory())
        else:
            values[item.name] = plain(item.default)
    return values


def _environment(command: str, values: dict[str, Any]) -> Any:
    """Returns the checked environment of plain values; for ``evaluate``, a mapping of the given fields."""
    partial = command == "evaluate"
    if partial:
        values = {key: value for key, value in values.items() if value}
    spec = _adapter(EnvSpec).validate_python(values)
    given = values if partial else plain(spec)
    _check_environment(given)
    scenario = checked_scenario(spec.task, spec.task_kwargs, spec.scenario) if "task" in given else {}
    if partial:  # not shortened: a change back to the task's own value counts after training with another
        return {key: getattr(spec, key) for key in given}
    return spec.replace(scenario=scenario)


@cache
def policy_config(policy: str) -> type:
    """Returns the configuration dataclass of a policy, without importing its model.

    Raises:
        UnknownNameError: if no such policy is registered.
    """
    return policies.config_class(policy)


def _check_environment(given: Mapping[str, Any]) -> None:
    """Checks the registered names, options and settings among the fields of an environment.

    Raises:
        UnknownNameError: A task, simulator or renderer does not exist, or has no such option or setting.
        ConfigError: An option or a setting has a value that it may not have.
    """
    registries = _registries()
    for key in ("task", "simulator", "renderer"):
        valid = set(registries[key].names())
        if key == "renderer":  # another simulator can render
            valid |= set(registries["simulator"].names())
        if key in given and given[key] not in valid:
            raise unknown_name(key, given[key], valid)
    if "simulator" in given:
        check_settings(given["simulator"], given.get("simulator_settings", {}))
    if given.get("task_kwargs") and "task" in given:
        task = registries["task"].get(given["task"])
        options = [item.name for item in dataclasses.fields(task)]
        for key in given["task_kwargs"]:
            if key not in options:
                raise unknown_name(f"option of {given['task']}", key, options)
        task(**given["task_kwargs"])  # the task checks the values


def _check_lists(config: Any) -> None:
    """Checks the registered names of ``simulator``, ``simulators`` and ``tasks`` outside an environment.

    Raises:
        UnknownNameError: One does not exist.
    """
    registries = _registries()
    given = {key: getattr(config, f"{key}s", ()) for key in ("task", "simulator")}
    if hasattr(config, "simulator"):
        given["simulator"] = (config.simulator,)
    for key, names in given.items():
        for name in names:
            if name not in registries[key]:
                raise unknown_name(key, name, registries[key].names())


def _registries() -> dict[str, Any]:
    handlers = importlib.import_module("envs.simulators")
    return {
        "task": importlib.import_module("envs.tasks").TASKS,
        "simulator": handlers.HANDLERS,
        "renderer": handlers.RENDERERS,
    }


@cache
def _adapter(settings: type) -> Any:
    """What checks the values of a dataclass; to make it takes longer than to use it."""
    from pydantic import TypeAdapter

    return TypeAdapter(settings)


def _readable(error: Any, policy_name: str | None) -> ConfigError:
    """One line per wrong value, of a pydantic ValidationError."""
    lines = []
    for item in error.errors():
        cause = item.get("ctx", {}).get("error")
        if isinstance(cause, Exception):  # our own check, which says everything already
            lines.append(str(cause))
            continue
        prefix = "policy." if policy_name and error.title == policy_config(policy_name).__name__ else ""
        key = prefix + ".".join(str(part) for part in item["loc"])
        lines.append(f"{key}: {wrong_value(item)}")
    return ConfigError(" ".join(dict.fromkeys(lines)))
