"""Keys of the command line: dotted, in full or by their last part where only one key ends so."""

import re
from collections.abc import Iterable, Mapping
from typing import Any

import policies
from envs.core.errors import ConfigError, UnknownNameError, suggest
from envs.core.json_values import flat
from roboverse_learn.config.scenario_overrides import SECTION, scenario_keys

_WORD = re.compile(r"(?P<key>[A-Za-z_]\w*(?:\.\w+)*)=(?P<value>.*)", re.DOTALL)

FROM = "from_dataset"
_TYPED = {"policy_name": "policy", FROM: "from"}
"""Fields that are typed by another word; ``from`` is a word of Python, in which the field's name is given."""

_ALIASES = {("evaluate", "policy.path"): "checkpoint", ("evaluate", "path"): "checkpoint"}
"""Keys that a command takes under another name too, the one that LeRobot's programs have."""

_ELSEWHERE = {
    ("view", "out"): "file",
    ("collect", "out"): "dataset",
    ("collect", "recordings"): "path",
    ("teleoperate", "path"): "recordings",
    ("train", "out"): "run",
    ("sweep", "out"): "runs_dir",
    ("evaluate", "level"): "levels",
    ("evaluate", "out"): "results_dir",
}
"""Keys of other commands, by what stands for them in a command that has none of this name."""

OPEN = {
    "task_kwargs": "variant=lift",
    "simulator_settings": "njmax=768",
    "launcher_settings": "partition=gpu",
    SECTION: "physics.decimation=50",
    "policy.settings": "chunk_size=16",
}
"""Sections whose keys belong to the task, the simulator, the launcher, the scene or a LeRobot policy, each
with an example."""

MAPS = ("rename_map", "policy.rename_map")
"""Keys whose value is a map, given as a whole: ``rename_map={front:camera1}``, or as JSON."""


def plugin_names(words: Iterable[str]) -> list[str]:
    """Returns the plugins that words name, as ``plugins=[a,b]`` does, each once."""
    given = [word.removeprefix("plugins=").strip("[]") for word in words if word.startswith("plugins=")]
    return list(dict.fromkeys(filter(None, ",".join(given).replace(" ", "").split(","))))


def flat_keys(values: Mapping[str, Any], prefix: str = "") -> list[str]:
    """Returns the dotted key of every leaf; an open section is a leaf."""
    return list(flat(values, prefix, (*OPEN, *MAPS)))


def at(values: Mapping[str, Any], key: str) -> Any:
    """Returns the value of a dotted key, None where there is none."""
    value: Any = values
    for part in key.split("."):
        value = value.get(part) if isinstance(value, Mapping) else None
    return value


def open_section(key: str) -> str:
    """Returns the open section that a dotted key is inside of; empty for none."""
    return next((section for section in OPEN if key.startswith(f"{section}.")), "")


def own_key(policy: str, key: str) -> str:
    """Returns the key of a setting that a policy's configuration takes without naming it.

    ``policy.chunk_size`` of a LeRobot policy is ``policy.settings.chunk_size``: the field of ``open_field``.
    """
    section, _, rest = key.partition(".")
    own = policies.config_class(policy) if section == "policy" and policy in policies.names() else None
    field = getattr(own, "open_field", "")
    if not rest or not field or rest.partition(".")[0] in own.__dataclass_fields__:  # pyright: ignore
        return key
    return f"policy.{field}.{rest}"


def split_word(word: str, keys: Iterable[str]) -> tuple[str, str]:
    """Returns the key and the value of a word ``key=value``.

    Args:
        word: The word.
        keys: Dotted keys, of which the nearest is suggested.

    Raises:
        ConfigError: The word is not ``key=value``.
    """
    match = _WORD.fullmatch(word)
    if match is None:
        raise ConfigError(
            f"'{word}' is not key=value.{suggest(word, [f'{key}=' for key in _typed(keys)])} "
            "Write words such as task=PickCube or train.steps=1000; --help lists every key."
        )
    return match["key"], match["value"]


def full_key(command: str, key: str, keys: Iterable[str]) -> str:
    """Returns the full dotted key of ``key``.

    Raises:
        ConfigError: It could be several, or is a whole section.
        UnknownNameError: It is none.
    """
    names, key = _typed(keys), _ALIASES.get((command, key), key)
    if key in OPEN and key in names:
        raise ConfigError(f"'{key}' has keys of its own: give each by its name, as in {key}.{OPEN[key]}.")
    if key in (FROM, _TYPED[FROM]) and _TYPED[FROM] in names:
        return FROM
    if key in names or open_section(key) in names:
        return key
    matches = [full for full in names if full.endswith(f".{key}")]
    if len(matches) > 1:
        raise ConfigError(f"'{key}' could be {' or '.join(matches)}: write the one that is meant.")
    if not matches:
        raise unknown_key(command, key, names)
    return matches[0]


class UnknownKeyError(UnknownNameError):
    """A key that a command has not.

    Attributes:
        key: The key.
        keys: Those that the command has.
    """

    def __init__(self, message: str, key: str = "", keys: Iterable[str] = ()) -> None:
        super().__init__(message)
        self.key, self.keys = key, tuple(keys)


def unknown_key(command: str, key: str, keys: Iterable[str]) -> UnknownKeyError:
    """Returns the error of an unknown key, which suggests the nearest one."""
    names = _typed(keys)
    section = key.rpartition(".")[0]
    valid = [full for full in names if section and full.startswith(f"{section}.")]
    if not valid:
        valid = sorted({f"{full.partition('.')[0]}.*" if "." in full else full for full in names})
    known = list(names)
    if SECTION in names:  # a word alone is near to one of the many parts of a scene by accident
        known += [full for full in scenario_keys() if "." in key or full.endswith(f".{key}")]
    by_part = {full.rpartition(".")[2]: full for full in reversed(known)} | {full: full for full in known}
    meant = _ELSEWHERE.get((command, key))
    hint = f" Did you mean '{meant}'?" if meant else _of_other_policies(key) or suggest(key, by_part, by_part)
    return UnknownKeyError(
        f"Unknown key '{key}' of {command}.{hint} Valid: {', '.join(valid)}. "
        f"See them all with: roboverse {command} --help",
        key,
        names,
    )


def _typed(keys: Iterable[str]) -> list[str]:
    """Returns the keys as they are typed."""
    return [typed_key(key) for key in keys]


def typed_key(key: str) -> str:
    """Returns a key as it is typed: the policy's name is ``policy``."""
    return _TYPED.get(key, key)


def _of_other_policies(key: str) -> str:
    """Returns which policies have a key that the chosen one has not."""
    section, _, last = key.rpartition(".")
    entries = [policies.POLICIES.entry(name) for name in policies.names()]
    own = [entry.name for entry in entries if not entry.distribution and not entry.rivals]
    fields = {name: policies.config_class(name).__dataclass_fields__ for name in own}
    having = [name for name in fields if last in fields[name]] if section in ("", "policy") else []
    return f" It is a key of policy={' and policy='.join(having)}." if having else ""
