"""What stands before ``=`` on the command line: dotted keys, whole or shortened."""

import re
from collections.abc import Iterable, Mapping
from typing import Any

import policies
from envs.core.errors import ConfigError, UnknownNameError, suggest
from roboverse_learn.config.scenario_overrides import SECTION, in_full, scenario_keys, typed_keys

_WORD = re.compile(r"(?P<key>[A-Za-z_]\w*(?:\.\w+)*)=(?P<value>.*)", re.DOTALL)

OPEN = {
    "task_kwargs": "variant=lift",
    "simulator_settings": "njmax=768",
    SECTION: "physics.decimation=50",
}
"""The sections whose keys are not ours: fields of the task's dataclass, the simulator's and the scene's.

Each with an example."""


def flat_keys(values: Mapping[str, Any], prefix: str = "") -> list[str]:
    """Returns the dotted key of every leaf."""
    keys: list[str] = []
    for name, value in values.items():
        nested = isinstance(value, Mapping) and f"{prefix}{name}" not in OPEN
        keys += flat_keys(value, f"{prefix}{name}.") if nested else [f"{prefix}{name}"]
    return keys


def at(values: Mapping[str, Any], key: str) -> Any:
    """Returns the value of a dotted key, None where there is none."""
    value: Any = values
    for part in key.split("."):
        value = value.get(part) if isinstance(value, Mapping) else None
    return value


def split_word(word: str, keys: Iterable[str]) -> tuple[str, str]:
    """Returns key and value of a word ``key=value``.

    Args:
        word: The word.
        keys: Dotted keys, of which the nearest is suggested.

    Raises:
        ConfigError: The word is not ``key=value``.
    """
    match = _WORD.fullmatch(word)
    if match is None:
        raise ConfigError(
            f"'{word}' is not key=value.{suggest(word, [f'{key}=' for key in _settable(keys)])} "
            "Write words such as task=PickCube or train.steps=1000; --help lists every key."
        )
    return match["key"], match["value"]


def full_key(command: str, key: str, keys: Iterable[str]) -> str:
    """Returns the dotted key that ``key`` stands for, whole or shortened.

    Raises:
        ConfigError: It could be several, or stands for a whole section.
        UnknownNameError: It is none.
    """
    names = _settable(keys)
    if key in names and key in OPEN:
        raise ConfigError(f"'{key}' has keys of its own: give each by its name, as in {key}.{OPEN[key]}.")
    if key in names or (in_open_section(key) and key.partition(".")[0] in names):
        return key
    has_scene = SECTION in names
    if has_scene:
        names = [name for name in names if name != SECTION] + typed_keys()
    matches = [full for full in names if full.endswith(f".{key}")]
    if not matches and has_scene and (of_scene := in_full(key)):
        return of_scene  # whether there is such a camera, its task says
    if len(matches) > 1:
        raise ConfigError(f"'{key}' could be {' or '.join(matches)}: write the one that is meant.")
    if not matches:
        raise unknown_key(command, key, [*names, *scenario_keys()] if has_scene else names)
    return matches[0]


def in_open_section(key: str) -> bool:
    """Whether a dotted key names an option of a task, a setting of a simulator or a part of the scene."""
    section, dot, _ = key.partition(".")
    return bool(dot) and section in OPEN


def _settable(keys: Iterable[str]) -> list[str]:
    """Returns what may stand before ``=``: every key, and ``policy`` for the policy's name."""
    return ["policy" if key == "policy_name" else key for key in keys]


def unknown_key(command: str, key: str, keys: Iterable[str]) -> UnknownNameError:
    """The error of an unknown key: nearest key of all, and the keys beside it."""
    names = _settable(keys)
    section = key.rpartition(".")[0]
    beside = [full for full in names if section and full.startswith(f"{section}.")]
    if not beside:
        tops = (full.partition(".") for full in names)
        beside = sorted({f"{top}.*" if rest else top for top, _, rest in tops})
    shortened = {full.rpartition(".")[2]: full for full in reversed(names)}
    ends_so = shortened.get(key.rpartition(".")[2], "")
    if "<" in ends_so:  # a name has to be filled in
        nearest = f" Did you mean '{ends_so}'?"
    else:
        nearest = suggest(key, [*names, *(short for short, full in shortened.items() if "<" not in full)])
    return UnknownNameError(
        f"Unknown key '{key}' of {command}.{_of_others(key) or nearest} Valid: {', '.join(beside)}. "
        f"See them all with: roboverse {command} --help"
    )


def _of_others(key: str) -> str:
    """Says which policies have a key that the chosen one has not."""
    section, _, last = key.rpartition(".")
    fields = {name: policies.config_class(name).__dataclass_fields__ for name in policies.names()}
    having = [name for name in fields if last in fields[name]] if section in ("", "policy") else []
    return f" It is a key of policy={' and policy='.join(having)}." if having else ""
