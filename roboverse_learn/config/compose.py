"""Composes command line arguments into a frozen configuration.

The last of these that sets a value wins:

1. the defaults of the dataclasses (:mod:`roboverse_learn.config.schema`),
2. ``configs/policy/<policy>.yaml``, ``configs/preset/<preset>.yaml``,
   ``configs/policy_preset/<preset>_<policy>.yaml`` and
   ``configs/task_preset/<task>/<preset>_<policy>.yaml``, composed by Hydra; over them, for ``train``, the
   settings of the dataset that ``dataset=`` names,
3. for ``train``, ``configs/recipe/<recipe>.yaml``, with the preset ``full``; for ``evaluate``, the
   values of the protocol that ``protocol=`` names,
4. the saved configuration of the run that ``run=`` names, in place of 1 to 3,
5. the command line, in Hydra's grammar of values, later words last.

What is evaluated follows the checkpoint: ``evaluate`` takes no field of the environment from 2. The task of
``collect`` is that of the source's checkpoint or dataset, and that of ``teleoperate`` its checkpoint's, where
there is one and the command line names none.
"""

import copy
import itertools
from collections.abc import Mapping, Sequence
from functools import cache
from pathlib import Path
from typing import Any

import policies
from envs.core.errors import ConfigError, unknown_name
from envs.core.json_values import flat, to_json_values
from envs.core.registry import OF_YOUR_OWN
from envs.scenario.changes import merged
from envs.spec import EnvSpec
from envs.tasks.protocols import PROTOCOLS
from envs.tasks.suites import suite_tasks
from policies.base import listed
from policies.checkpoint import learned_tasks
from roboverse_learn.config.command_line_keys import (
    MAPS,
    at,
    flat_keys,
    full_key,
    open_section,
    own_key,
    split_word,
)
from roboverse_learn.config.demonstration_keys import check_demonstration_keys
from roboverse_learn.config.idle_keys import check_idle_keys
from roboverse_learn.config.path_keys import check_path
from roboverse_learn.config.recipes import check_beside, read_recipe
from roboverse_learn.config.recorded_settings import values_of_dataset
from roboverse_learn.config.schema import DEFAULT_PRESETS, NAMES_A_POLICY
from roboverse_learn.config.serialize import default_values, env_keys, from_values, task_names, to_values
from roboverse_learn.config.suite_check import check_keys_of_chains, check_suite
from roboverse_learn.data.sources import SOURCES

ALL_CAMERAS = "all"
"""``cameras=[all]``: every camera of the task."""

_GROUPS = {"policy", "preset"}
_NO_POLICY = ""


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


def compose(command: str, words: Sequence[str], given: Mapping[str, Any] | None = None) -> Any:
    """Builds the configuration of a command.

    Args:
        command: One of :data:`roboverse_learn.config.schema.COMMANDS`.
        words: ``key=value`` words. One value is a list of one where a list is meant: ``levels=0``.
        given: Values by key, as a program has them, which win over the words. Nested ones are of keys with
            dots: ``{"train": {"steps": 5}}`` is ``{"train.steps": 5}``.

    Returns:
        The command's frozen dataclass.

    Raises:
        UnknownNameError: A key, policy, preset, task, simulator or renderer does not exist.
        ConfigError: A value is of the wrong kind or out of range, or a word is not ``key=value``.
    """
    settings: list[tuple[str, str, Any]] = [(word, *_split(word)) for word in words]
    read = flat(given or {}, leaves=MAPS)
    settings += [("", key, to_json_values(value)) for key, value in read.items()]  # no word is to be read
    typed = {key: value for _, key, value in settings if isinstance(value, str)}
    saved = _saved_values(typed.get("run", "")) if command == "train" else {}
    recipe, of_recipe = _recipe(command, typed.get("recipe", ""))
    chosen = of_recipe.get("policy_name", saved.get("policy_name", "act"))
    policy = _policy(command, typed, chosen)
    preset = typed.get("preset", DEFAULT_PRESETS.get(command, "full"))
    for kind, name, names in (("policy", policy, policies.names()), ("preset", preset, preset_names())):
        if name not in names and (command, name) != ("check", _NO_POLICY):
            raise unknown_name(kind, name, names, OF_YOUR_OWN if kind == "policy" else "")
    defaults = default_values(command, policy)
    known = flat_keys(defaults)
    keys = [full_key(command, own_key(policy, key), known) for _, key, _ in settings]
    _check_paths(keys, settings, defaults)
    check_demonstration_keys(command, policy, keys)
    check_beside(recipe or str(saved.get("recipe", "")), chosen, policy, keys)
    recorded = values_of_dataset(command, {key: value for _, key, value in settings})
    task = typed.get("task") or recorded.get("task") or defaults.get("task", "")
    task_preset = _task_preset(str(task), preset, policy)
    values = merged(copy.deepcopy(_composed(command, policy, preset, task_preset)), recorded)
    values = merged(values, of_recipe)
    if saved.get("policy_name") == policy:
        values = saved | ({"preset": preset} if "preset" in typed else {})
    if command == "evaluate":
        values |= {key: defaults[key] for key in env_keys(command)}
        values = merged(values, _protocol(typed.get("protocol", "")))
    if command in NAMES_A_POLICY:
        values["policy_name"] = typed.get("policy", "")
    for key, (word, _, value) in zip(keys, settings, strict=True):
        if key not in _GROUPS:
            default = at(defaults, key)
            value = _value(word, value, command, key, default) if word else _in_list(value, default)
            _put(values, key, value)
    if recipe:
        values["recipe"] = recipe
    check_suite(typed.get("suite", ""), task=typed.get("task", ""))
    check_keys_of_chains(bool(values.get("chains")), keys)
    _split_tasks(command, values, names_others="policy.tasks" in keys)
    _name_task_and_cameras(command, values, typed)
    config = from_values(command, values)
    check_idle_keys(values, [*keys, *flat_keys(of_recipe)])
    return config


def _check_paths(
    keys: Sequence[str], settings: Sequence[tuple[str, str, Any]], defaults: Mapping[str, Any]
) -> None:
    """Checks that no file or folder is named by an empty text; a program may pass on an empty default."""
    for key, (word, typed, value) in zip(keys, settings, strict=True):
        if word or at(defaults, key):
            check_path(key, typed, value)


def _policy(command: str, typed: Mapping[str, Any], chosen: Any) -> str:
    """Returns the policy whose values are composed; for ``check`` without one, the preset's values alone."""
    if command == "evaluate":
        return "act"
    return str(typed.get("policy", _NO_POLICY if command == "check" else chosen))


def _split_tasks(command: str, values: dict[str, Any], *, names_others: bool) -> None:
    """Replaces a list of tasks of ``train``, or a suite, by the first, and by the others as ``policy.tasks``.

    Raises:
        ConfigError: The policy learns one task alone.
    """
    given = values.get("task", "")
    if command == "train" and values["suite"] and "tasks" in values["policy"]:
        given, values["suite"] = list(suite_tasks(values["suite"])), ""
    if command != "train":
        return
    first, *others = task_names(given)
    values["task"] = first
    if not others:
        return
    if "tasks" not in values["policy"]:
        raise ConfigError(
            f"task={listed([first, *others])} are several, and policy={values['policy_name']} learns one. "
            "policy=mtact learns several by their instructions; or give one task."
        )
    values["policy"]["tasks"] = [*others, *(values["policy"]["tasks"] if names_others else ())]


def _name_task_and_cameras(command: str, values: dict[str, Any], typed: Mapping[str, Any]) -> None:
    """Replaces a task that a checkpoint decides, and ``cameras=[all]``, by names."""
    names_task = "task" in typed or bool(typed.get("suite"))
    if command == "collect" and not names_task:
        values["task"] = SOURCES.get(values["source"]).task_of(values) or values["task"]
    if command == "teleoperate" and values["checkpoint"] and not names_task:
        values["task"] = _task_of(str(values["checkpoint"])) or values["task"]
    if command == "check" and not names_task:
        checks_robot = values["robot"] and not values["policy_name"]
        values["task"] = "" if checks_robot else values["task"]
    if values.get("cameras") == [ALL_CAMERAS]:
        values["cameras"] = _all_cameras(values)


def _all_cameras(values: Mapping[str, Any]) -> list[str]:
    """Returns the cameras of the task, or of all tasks that are named.

    Raises:
        ConfigError: Tasks have different cameras.
    """
    suite: Any = values.get("suite")
    cameras: dict[str, list[str]] = {}
    for task in suite_tasks(suite) if suite else task_names(values["task"]):
        scene = EnvSpec(task=task, task_kwargs=values["task_kwargs"]).make_task().scenario
        cameras[task] = [camera.name for camera in scene.cameras]
    first, *others = cameras
    for other in others:
        if cameras[other] != cameras[first]:
            raise ConfigError(
                f"cameras=[all] is {listed(cameras[first])} in {first} and {listed(cameras[other])} in "
                f"{other}. Name the cameras that all of the tasks have."
            )
    return cameras[first]


def _protocol(name: str) -> dict[str, Any]:
    """Returns the values of another benchmark's protocol.

    Raises:
        UnknownNameError: There is none of that name.
    """
    if not name:
        return {}
    own = PROTOCOLS.get(name)
    episodes = {"levels": [0], "splits": ["test"], "episodes": own.episodes}
    return to_json_values(own.env) | {"evaluate": episodes}


def _task_of(checkpoint: str) -> str:
    """Returns the task that a checkpoint learned first; nothing where neither it nor a run of it says."""
    from roboverse_learn.commands.run_folder import read_config, run_of

    if learned := learned_tasks(checkpoint):
        return learned[0]
    run = run_of(Path(checkpoint, "any")) if checkpoint else None
    return "" if run is None else str(read_config(run).env.task)


def _recipe(command: str, name: str) -> tuple[str, dict[str, Any]]:
    """Returns the name and the values of a recipe; none for other commands than ``train``."""
    if command != "train" or not name:
        return "", {}
    return read_recipe(name, configs_folder() / "recipe")


MOST_VALUES = 1000
"""Values of one key of a sweep, each of which is a run or more."""


def values_of_key(word: str) -> list[str]:
    """Expands an argument with several values: ``level=0,1`` is ``level=0`` and ``level=1``.

    Several values are written as for Hydra's own sweeps: with commas, or as ``range(4)``.

    Raises:
        ConfigError: The word is not ``key=value``, or has more than :data:`MOST_VALUES` values.
    """
    from hydra.errors import HydraException

    key, text = _split(word)
    try:
        override = _parsed(text)
    except HydraException:  # a path, which is one value; compose names what is wrong with it
        return [word]
    if not override.is_sweep_override():
        return [word]
    texts = itertools.islice(override.sweep_string_iterator(), MOST_VALUES + 1)
    values = [f"{key}={text}" for text in texts]
    if len(values) > MOST_VALUES:
        raise ConfigError(
            f"'{word}' has more than {MOST_VALUES:,} values. Give each of them a run, or fewer."
        )
    return values


def _split(word: str) -> tuple[str, str]:
    return split_word(word, flat_keys(default_values("train")))


def _saved_values(run: str) -> dict[str, Any]:
    """Returns the configuration that a run was started with; nothing where there is no such run."""
    from roboverse_learn.commands.run_folder import CONFIG_FILE, read_config

    folder = Path(run)
    return to_values(read_config(folder)) if run and (folder / CONFIG_FILE).exists() else {}


def _task_preset(task: str, preset: str, policy: str) -> str:
    """Returns the file of what one task needs of its own in a preset; nothing where there is none."""
    name = f"{task.strip('[] ')}/{preset}_{policy}"
    return name if (configs_folder() / "task_preset" / f"{name}.yaml").is_file() else ""


@cache
def _composed(command: str, policy: str, preset: str, task_preset: str) -> dict[str, Any]:
    """Returns the defaults of a command with the YAML files over them, merged by Hydra."""
    defaults = default_values(command, policy)
    if "preset" not in defaults:
        return defaults
    import hydra
    from hydra.core.config_store import ConfigStore
    from omegaconf import OmegaConf

    ConfigStore.instance().store(name="defaults_of_dataclasses", node=defaults)
    with hydra.initialize_config_dir(str(configs_folder()), version_base="1.3"):
        own = [f"+task_preset={task_preset}"] if task_preset else []
        composed = hydra.compose("run", [f"policy={policy or 'none'}", f"preset={preset}", *own])
    values: Any = OmegaConf.to_container(composed, resolve=True)
    return {key: values[key] for key in defaults}  # the files also have keys of other commands


def _parsed(text: str) -> Any:
    from hydra.core.override_parser.overrides_parser import OverridesParser

    return OverridesParser.create().parse_override(f"key={text}")


def _value(word: str, text: str, command: str, key: str, default: Any) -> Any:
    """Reads a value in Hydra's grammar; a path or a name is taken as it was typed.

    Raises:
        ConfigError: It is neither one value nor one list.
    """
    from hydra.errors import HydraException

    if isinstance(default, str):
        return text
    if key in MAPS:
        return _map(word, text, key)
    example = "" if default is None else f", such as {key}={str(default).lower()}"
    shown = f"[{text}]" if "," in text and not set(text) & set("()[]{}") else "[1,2]"
    takes = f"Write a list in brackets, such as {shown}." if isinstance(default, list) else ""
    takes = takes or f"{key} takes one value{example}."
    if open_section(key):
        takes = "Write a list in brackets, such as [1,2], and text with other signs in quotes."
    try:
        override = _parsed(text)
    except HydraException as error:
        raise ConfigError(f"'{word}' cannot be read: check its brackets and quotes. {takes}") from error
    if override.is_sweep_override():
        runs = f" For a run with each of them: roboverse sweep {word}" if command == "train" else ""
        raise ConfigError(f"'{word}' gives several values. {takes}{runs}")
    value = override.value()
    if isinstance(value, dict) and not open_section(key):
        raise ConfigError(f"'{word}' gives keys of its own. {takes}")
    return _in_list(value, default)


def _map(word: str, text: str, key: str) -> dict[str, str]:
    """Reads a map, in Hydra's grammar or as JSON.

    Raises:
        ConfigError: It is none.
    """
    import json

    from hydra.errors import HydraException

    try:
        value = json.loads(text)
    except ValueError:
        try:
            value = _parsed(text).value()
        except HydraException:
            value = None
    if not isinstance(value, dict) or not all(isinstance(each, str) for each in value.values()):
        raise ConfigError(
            f"'{word}' is no map of names. Write it in quotes, as in '{key}={{front:camera1}}'."
        )
    return {str(name): each for name, each in value.items()}


def _in_list(value: Any, default: Any) -> Any:
    """Returns one value as a list of one where a list is meant."""
    one = (value and isinstance(value, str)) or type(value) in (int, float)
    return [value] if isinstance(default, list) and one else value


def _put(values: dict[str, Any], key: str, value: Any) -> None:
    """Puts the value of a dotted key into nested values; keys of an open section are merged."""
    section = open_section(key)
    for part in reversed(key.removeprefix(f"{section}.").split(".") if section else ()):
        value = {part: value}
    outer, _, name = (section or key).rpartition(".")
    holder = at(values, outer) if outer else values
    holder[name] = merged(holder[name], value) if section else value
