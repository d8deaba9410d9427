"""From the words of a command line to a frozen configuration.

Hydra composes the groups of ``configs/`` over the dataclasses' defaults,
:mod:`roboverse_learn.config.serialize` checks the values, and every mistake becomes one message that says
what was given and what is valid.
"""

import copy
from collections.abc import Mapping, Sequence
from functools import cache
from pathlib import Path
from typing import TYPE_CHECKING, Any

import policies
from envs.core.errors import ConfigError, unknown_name
from envs.scenario.changes import merged
from policies.checkpoint import learned_tasks
from roboverse_learn.config.grammar import UNKNOWN, check_value
from roboverse_learn.config.keys import OPEN, at, flat_keys, full_key, in_open_section, split_word
from roboverse_learn.config.serialize import default_values, from_values, to_values

if TYPE_CHECKING:
    from omegaconf import DictConfig

_GROUPS = ("policy", "preset")


def configs_folder() -> Path:
    """Returns the folder of the YAML files: inside an installed package, or beside it in a checkout."""
    package = Path(__file__).resolve().parents[1]
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
        if key not in _GROUPS and isinstance(at(defaults, key), str)
    }
    for key, (typed, value) in zip(full, pairs, strict=True):
        if key not in (*texts, *_GROUPS):
            default = UNKNOWN if in_open_section(key) else at(defaults, key)
            check_value(f"{typed}={value}", command, default)
    overrides = [
        f"{'++' if in_open_section(key) else ''}{key}={value}"
        for key, value in given.items()
        if key not in (*texts, *_GROUPS)
    ]
    composed = _overridden(_composed(command, choices["policy"], choices["preset"]), overrides)
    for key, value in texts.items():
        _set(composed, key, value)
    for key in given:
        if isinstance(at(defaults, key), list):
            _set(composed, key, _as_list(at(composed, key)))
    values = _after_checkpoint(command, {name: composed[name] for name in defaults}, defaults, set(given))
    if saved and saved["policy_name"] == values["policy_name"]:
        values = _overlay(saved, values, set(full))
    return from_values(command, values)


def _after_checkpoint(
    command: str, values: dict[str, Any], defaults: dict[str, Any], given: set[str]
) -> dict[str, Any]:
    """Returns the values of a command that takes a checkpoint, which decides what the user leaves open."""
    if command == "evaluate":  # its scene follows the checkpoint, whatever a preset says of training
        return {
            name: value if isinstance(value, dict) or name in given or name == "preset" else defaults[name]
            for name, value in values.items()
        }
    if command == "collect" and values["source"] == "policy" and "task" not in given:
        return values | {"task": next(iter(learned_tasks(str(values["checkpoint"]))), values["task"])}
    return values


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


def _all_defaults(command: str, policy: str) -> dict[str, Any]:
    """The defaults of the commands that presets speak of, and of this one, which takes its part."""
    return {
        key: value
        for each in ("leaderboard", "evaluate", "train", command)
        for key, value in default_values(each, policy).items()
    }


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
    from roboverse_learn.commands.run_folder import CONFIG_FILE, read_config

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


@cache
def _composed(command: str, policy: str, preset: str) -> "DictConfig":
    """Lets Hydra merge the defaults and the groups: always the same, and nearly all that takes time."""
    import hydra
    from hydra.core.config_store import ConfigStore

    ConfigStore.instance().store(name="defaults_of_dataclasses", node=_all_defaults(command, policy))
    with hydra.initialize_config_dir(str(configs_folder()), version_base="1.3"):
        return hydra.compose("run", [f"policy={policy}", f"preset={preset}"])


def _overridden(composed: "DictConfig", overrides: list[str]) -> dict[str, Any]:
    """Puts the words of a command line, in Hydra's grammar, over what was composed; returns plain values."""
    from hydra.core.override_parser.overrides_parser import OverridesParser
    from hydra.errors import HydraException
    from omegaconf import OmegaConf
    from omegaconf.errors import InterpolationResolutionError, OmegaConfBaseException

    config = copy.deepcopy(composed)
    try:
        for each in OverridesParser.create().parse_overrides(overrides):
            OmegaConf.update(config, each.key_or_group, each.value(), force_add=each.is_force_add())
        values = OmegaConf.to_container(config, resolve=True)
    except InterpolationResolutionError as error:
        named = " ".join(word.lstrip("+") for word in overrides if "${" in word)
        raise ConfigError(
            f"'{named}' cannot be read: ${{…}} stands for the value of another key, and there is none of "
            "this name. Where the characters themselves are meant, write \\${ instead."
        ) from error
    except (HydraException, OmegaConfBaseException) as error:
        raise ConfigError(f"The command line could not be read: {_first_lines(error)}") from error
    assert isinstance(values, dict)
    return {str(key): value for key, value in values.items()}


def _first_lines(error: Exception) -> str:
    """One line of what a library said over several."""
    return " ".join(line.strip() for line in str(error).splitlines() if line.strip())
