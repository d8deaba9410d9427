"""The policy types of the installed LeRobot and their settings, read from its source without importing it.

Importing LeRobot's policies takes half a minute where ``transformers`` is installed. Names, keys and
defaults are needed for every command line, so they are parsed.
"""

import ast
from functools import cache
from importlib.metadata import distributions
from importlib.util import find_spec
from pathlib import Path
from typing import Any

from envs.core.errors import PolicyError, suggest, unknown_name

EXTRA = "vla"
"""Our optional extra with what the types need beside LeRobot."""

DROP_LAST_FRAMES = "drop_n_last_frames"
"""A setting of some of LeRobot's types that every type takes here: it decides what is sampled."""

STATE_NOISE = "state_noise"
"""A setting that LeRobot's types lack and every type takes here: it changes what is sampled."""

OF_TRAINING = (DROP_LAST_FRAMES, STATE_NOISE)
"""Settings that training alone reads, so that a type's configuration need not have them."""

_NOT_FOR_DEMONSTRATIONS = ("gaussian_actor", "tdmpc")
"""Registered types that need rewards."""

_PLUGIN = "lerobot_policy_"
"""How a package's name begins that brings a policy to LeRobot (lerobot.utils.import_utils)."""

_SET_HERE = frozenset(
    {
        *(
            "device",
            "input_features",
            "output_features",
            "use_peft",
            "pretrained_path",
            "pretrained_revision",
        ),
        *("push_to_hub", "repo_id", "private", "tags", "license", "use_amp"),
    }
)
"""Settings of LeRobot's configuration that a dataset, our keys or our training loop decide."""


def type_names() -> list[str]:
    """Returns LeRobot's policy types that learn from demonstrations, sorted."""
    return sorted([*_files(), *_plugins()])


def check_type(name: str) -> None:
    """Checks that LeRobot has a policy type.

    Raises:
        UnknownNameError: if it has none of that name.
    """
    if name not in type_names():
        raise unknown_name("LeRobot policy", name, type_names())


def settings_of(name: str) -> dict[str, str]:
    """Returns the settings of a type: each name with its default, as LeRobot's source writes it.

    A type of a package beside LeRobot has none here; LeRobot checks its settings when it is made.
    """
    found = _files().get(name)
    if found is None:
        return {}
    return {
        key: default
        for path in (_folder().parent / "configs" / "policies.py", found)
        for key, default in _fields(path).items()
        if key not in _SET_HERE
    }


def check_settings(name: str, given: dict[str, Any]) -> None:
    """Checks names of settings.

    Raises:
        PolicyError: if the type has no such setting, or it is decided elsewhere.
    """
    valid = settings_of(name)
    for key in given:
        if key in _SET_HERE:
            raise PolicyError(
                f"policy.{key} is not given by hand: the dataset, policy.path, peft.* or device decide it."
            )
        if valid and key not in (*valid, *OF_TRAINING):
            raise PolicyError(
                f"LeRobot's {name} has no setting '{key}'.{suggest(key, valid)} Valid: "
                f"{', '.join(f'policy.{each}' for each in sorted({*valid, *OF_TRAINING}))}."
            )


@cache
def _files() -> dict[str, Path]:
    """Returns the file of each type's configuration."""
    files = {}
    for path in sorted(_folder().glob("*/configuration_*.py")):
        for node in ast.parse(path.read_text(encoding="utf-8")).body:
            for decorator in node.decorator_list if isinstance(node, ast.ClassDef) else ():
                if isinstance(decorator, ast.Call) and ast.unparse(decorator.func).endswith(
                    "register_subclass"
                ):
                    files[ast.literal_eval(decorator.args[0])] = path
    return {name: path for name, path in files.items() if name not in _NOT_FOR_DEMONSTRATIONS}


@cache
def _plugins() -> list[str]:
    """Returns the types of installed packages beside LeRobot; only if there are some is LeRobot imported."""
    names = (str(each.metadata["Name"]) for each in distributions())
    if not any(name.lower().replace("-", "_").startswith(_PLUGIN) for name in names):
        return []
    from lerobot.configs import PreTrainedConfig
    from lerobot.utils.import_utils import register_third_party_plugins

    before = set(PreTrainedConfig.get_known_choices())
    register_third_party_plugins()
    return sorted(set(PreTrainedConfig.get_known_choices()) - before)


def _folder() -> Path:
    spec = find_spec("lerobot")
    assert spec is not None
    assert spec.submodule_search_locations is not None
    return Path(next(iter(spec.submodule_search_locations))) / "policies"


@cache
def _fields(path: Path) -> dict[str, str]:
    """Returns the annotated fields of the dataclasses in a file that are policy configurations."""
    fields = {}
    for node in ast.parse(path.read_text(encoding="utf-8")).body:
        if not isinstance(node, ast.ClassDef) or not _is_configuration(node):
            continue
        for item in node.body:
            if isinstance(item, ast.AnnAssign) and isinstance(item.target, ast.Name) and item.value:
                fields[item.target.id] = ast.unparse(item.value)
    return fields


def _is_configuration(node: ast.ClassDef) -> bool:
    return node.name == "PreTrainedConfig" or any(
        "PreTrainedConfig" in ast.unparse(base) for base in node.bases
    )
