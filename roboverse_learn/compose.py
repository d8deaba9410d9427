"""From the words of a command line to a frozen configuration.

Hydra composes the groups of ``configs/`` over the dataclasses' defaults, pydantic checks the values, and
every mistake becomes one message that says what was given and what is valid.
"""

import dataclasses
import importlib
from collections.abc import Mapping, Sequence
from functools import cache
from pathlib import Path
from typing import Any

import policies
from envs.errors import ConfigError, unknown_name
from envs.handlers.settings import check_settings
from envs.scenario.changes import merged
from roboverse_learn.config import (
    CollectConfig,
    ConservationConfig,
    ConvertConfig,
    EvaluateConfig,
    LeaderboardConfig,
    ReplayConfig,
    SweepConfig,
    TrainRunConfig,
)
from roboverse_learn.keys import OPEN, flat_keys, full_key, in_open_section, split_word, unknown_key
from roboverse_learn.scenario_keys import checked_scenario

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

_GROUPS = ("policy", "preset")


def configs_folder() -> Path:
    """Returns the folder of the YAML files: inside an installed package, or beside it in a checkout."""
    package = Path(__file__).resolve().parent
    for folder in (package / "configs", package.parent / "configs"):
        if (folder / "run.yaml").is_file():
            return folder
    raise ConfigError(f"No configs folder beside {package}. Install roboverse-learn again.")


def preset_names() -> list[str]:
    """Returns the names of the presets, sorted."""
    return sorted(path.stem for path in (configs_folder() / "preset").glob("*.yaml"))


def compose(command: str, words: Sequence[str]) -> Any:
    """Builds the configuration of a command.

    Args:
        command: One of :data:`COMMANDS`.
        words: ``key=value`` words, later ones winning. A key may be shortened to its last part where no
            other key ends so: ``num_demos=50`` is ``collect.num_demos=50``. One value is a list of one
            where a list is meant: ``levels=0`` is ``levels=[0]``.

    Returns:
        The command's frozen dataclass.

    Raises:
        UnknownNameError: A key, policy, preset, task, simulator or renderer does not exist.
        ConfigError: A value is of the wrong kind or out of range, or a word is not ``key=value``.
    """
    pairs = [_split(word) for word in words]
    saved = _saved_values(command, dict(pairs))
    choices = {"policy": saved.get("policy_name", "act"), "preset": "full"}
    choices |= {key: value for key, value in pairs if key in _GROUPS}
    if choices["policy"] not in policies.names():
        raise unknown_name("policy", choices["policy"], policies.names())
    if choices["preset"] not in preset_names():
        raise unknown_name("preset", choices["preset"], preset_names())
    defaults = default_values(command, choices["policy"])
    keys = flat_keys(defaults)
    full = [full_key(command, key, keys) for key, _ in pairs]
    given = {key: value for key, (_, value) in zip(full, pairs, strict=True)}
    # A path or a name is taken as it was typed: Hydra's grammar would stumble over its '=', ',' and '['.
    texts = {
        key: value
        for key, value in given.items()
        if key not in _GROUPS and isinstance(_at(defaults, key), str)
    }
    groups = [f"{group}={name}" for group, name in choices.items()]
    overrides = [
        f"{'++' if in_open_section(key) else ''}{key}={value}"
        for key, value in given.items()
        if key not in (*texts, *_GROUPS)
    ]
    composed = _hydra_compose(_all_defaults(command, choices["policy"]), [*groups, *overrides])
    for key, value in texts.items():
        _set(composed, key, value)
    for key in given:
        if isinstance(_at(defaults, key), list):
            _set(composed, key, _as_list(_at(composed, key)))
    values = {name: composed[name] for name in defaults}
    if command == "evaluate":  # its scene follows the checkpoint, whatever a preset says of training
        values = {
            name: value if isinstance(value, dict) or name in given or name == "preset" else defaults[name]
            for name, value in values.items()
        }
    if saved and saved["policy_name"] == values["policy_name"]:
        values = _overlay(saved, values, set(full))
    return from_values(command, values)


def values_of_key(word: str) -> list[str]:
    """Returns the words that one word stands for: ``level=0,1`` is ``level=0`` and ``level=1``.

    Several values are written as for Hydra's own sweeps: with commas, or as ``range(4)``.

    Raises:
        ConfigError: The word is not ``key=value``.
    """
    from hydra.core.override_parser.overrides_parser import OverridesParser
    from hydra.errors import HydraException

    key, _ = _split(word)
    try:
        override = OverridesParser.create().parse_override(word)
    except HydraException:  # a path, which is one value; what is wrong with it is said when it is read
        return [word]
    if not override.is_sweep_override():
        return [word]
    return [f"{key}={value}" for value in override.sweep_string_iterator()]


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


@cache
def _adapter(settings: type) -> Any:
    """What checks the values of a dataclass; to make it takes longer than to use it."""
    from pydantic import TypeAdapter

    return TypeAdapter(settings)


def to_values(config: Any) -> dict[str, Any]:
    """Returns a configuration as nested plain JSON values; :func:`from_values` reads them back."""
    return _plain(dataclasses.asdict(config))


def default_values(command: str, policy: str = "act") -> dict[str, Any]:
    """Returns the dataclasses' defaults of a command, nested."""
    values: dict[str, Any] = {}
    for item in dataclasses.fields(COMMANDS[command]):
        if item.name == "policy":
            values["policy"] = to_values(policy_config(policy)())
        elif item.name == "policy_name":
            values["policy_name"] = policy
        elif item.default_factory is not dataclasses.MISSING:
            value = item.default_factory()
            values[item.name] = to_values(value) if dataclasses.is_dataclass(value) else _plain(value)
        else:
            values[item.name] = _plain(item.default)
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
    for name in getattr(config, "simulators", ()):
        if name not in registries["simulator"]:
            raise unknown_name("simulator", name, registries["simulator"].names())
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
    handlers = importlib.import_module("envs.handlers")
    return {
        "task": importlib.import_module("envs.tasks").TASKS,
        "simulator": handlers.HANDLERS,
        "renderer": handlers.RENDERERS,
    }


def _all_defaults(command: str, policy: str) -> dict[str, Any]:
    """The defaults of the commands that presets speak of, and of this one, which takes its part."""
    return {
        key: value
        for each in ("leaderboard", "evaluate", "train", command)
        for key, value in default_values(each, policy).items()
    }


def _at(values: Mapping[str, Any], key: str) -> Any:
    """Returns the value of a dotted key, None where there is none."""
    value: Any = values
    for part in key.split("."):
        value = value.get(part) if isinstance(value, Mapping) else None
    return value


def _as_list(value: Any) -> Any:
    """Returns a list of one for one number or word; what is neither is refused later, as it was typed."""
    return [value] if (value and isinstance(value, str)) or type(value) in (int, float) else value


def _set(values: dict[str, Any], key: str, value: Any) -> None:
    """Sets a dotted key."""
    *sections, last = key.split(".")
    for section in sections:
        values = values[section]
    values[last] = value


def _split(word: str) -> tuple[str, str]:
    return split_word(word, flat_keys(default_values("train")))


def _saved_values(command: str, words: Mapping[str, str]) -> dict[str, Any]:
    """Returns what the run named by ``run=`` was started with, if it exists."""
    if command != "train" or not words.get("run"):
        return {}
    from roboverse_learn.run import CONFIG_FILE, read_config

    folder = Path(words["run"])
    return to_values(read_config(folder)) if (folder / CONFIG_FILE).exists() else {}


def _overlay(
    saved: Mapping[str, Any], values: Mapping[str, Any], given: set[str], prefix: str = ""
) -> dict[str, Any]:
    """Returns ``saved`` with those leaves of ``values`` whose dotted key is ``given``."""
    return {
        name: _overlay(saved[name], value, given, f"{prefix}{name}.")
        if isinstance(value, Mapping) and name not in OPEN
        else _one_of(saved.get(name, value), value, f"{prefix}{name}", given)
        for name, value in values.items()
    }


def _one_of(saved: Any, value: Any, key: str, given: set[str]) -> Any:
    """Returns a saved value, or what was given in its place; an open section may be given in part."""
    if key in OPEN and any(full.startswith(f"{key}.") for full in given):
        return merged(saved, value)
    return value if key in given else saved


def _hydra_compose(defaults: dict[str, Any], overrides: list[str]) -> dict[str, Any]:
    """Lets Hydra merge the defaults, the groups and the command line; returns plain values."""
    import hydra
    from hydra.core.config_store import ConfigStore
    from hydra.errors import HydraException
    from omegaconf import OmegaConf
    from omegaconf.errors import OmegaConfBaseException

    ConfigStore.instance().store(name="defaults_of_dataclasses", node=defaults)
    try:
        with hydra.initialize_config_dir(str(configs_folder()), version_base="1.3"):
            composed = OmegaConf.to_container(hydra.compose("run", overrides), resolve=True)
    except (HydraException, OmegaConfBaseException) as error:
        raise ConfigError(f"The command line could not be read: {_first_lines(error)}") from error
    assert isinstance(composed, dict)
    return {str(key): value for key, value in composed.items()}


def _first_lines(error: Exception) -> str:
    """One line of what a library said over several."""
    return " ".join(line.strip() for line in str(error).splitlines() if line.strip())


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
        lines.append(f"{key}: {item['msg'][0].lower()}{item['msg'][1:]}, given {item['input']!r}.")
    return ConfigError(" ".join(dict.fromkeys(lines)))


def _plain(value: Any) -> Any:
    """Tuples to lists, paths to strings: what JSON and YAML have."""
    if isinstance(value, Mapping):
        return {str(key): _plain(item) for key, item in value.items()}
    if isinstance(value, tuple | list):
        return [_plain(item) for item in value]
    return str(value) if isinstance(value, Path) else value
