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
from roboverse_learn.config.keys import flat_keys, unknown_key
from roboverse_learn.config.scenario_overrides import checked_scenario
from roboverse_learn.config.schema import (
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
        if "policy" in plain:
            plain["policy"] = _adapter(policy_config(policy_name)).validate_python(plain["policy"])
        config = _adapter(COMMANDS[command]).validate_python(plain)
    except ValidationError as error:
        raise _readable(error, policy_name if "policy" in plain else None) from error
    check_names(config)
    if getattr(config, "scenario", None) and config.task:
        scenario = checked_scenario(config.task, config.task_kwargs, config.scenario)
        config = dataclasses.replace(config, scenario=scenario)
    return config


def to_values(config: Any) -> dict[str, Any]:
    """Returns a configuration as nested plain JSON values; :func:`from_values` reads them back."""
    return plain(config)


def default_values(command: str, policy: str = "act") -> dict[str, Any]:
    """Returns the dataclasses' defaults of a command, nested."""
    values: dict[str, Any] = {}
    for item in dataclasses.fields(COMMANDS[command]):
        if item.name == "policy":
            values["policy"] = to_values(policy_config(policy)())
        elif item.name == "policy_name":
            values["policy_name"] = policy
        elif item.default_factory is not dataclasses.MISSING:
            values[item.name] = plain(item.default_factory())
        else:
            values[item.name] = plain(item.default)
    return values


@cache
def policy_config(policy: str) -> type:
    """Returns the configuration dataclass of a policy, without importing its model.

    Raises:
        UnknownNameError: if no such policy is registered.
    """
    return policies.config_class(policy)


def check_names(config: Any) -> None:
    """Checks every registered name in a configuration.

    Raises:
        UnknownNameError: if a task, simulator or renderer does not exist.
    """
    registries = _registries()
    for key, registry in registries.items():
        name = getattr(config, key, "")
        drawn_by = registries["simulator"].names() if key == "renderer" else []
        if name and name not in registry and name not in drawn_by:
            raise unknown_name(key, name, {*registry.names(), *drawn_by})
    for key in ("task", "simulator"):
        for name in getattr(config, f"{key}s", ()):  # several at once
            if name not in registries[key]:
                raise unknown_name(key, name, registries[key].names())
    if getattr(config, "simulator", ""):
        check_settings(config.simulator, getattr(config, "simulator_settings", {}))
    if getattr(config, "task_kwargs", None) and config.task:
        task = registries["task"].get(config.task)
        options = [item.name for item in dataclasses.fields(task)]
        for key in config.task_kwargs:
            if key not in options:
                raise unknown_name(f"option of {config.task}", key, options)
        task(**config.task_kwargs)  # the task checks the values


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
