"""``python roboverse_learn/new.py task name=…``: a package with a working task, policy or robot."""

import sys
from pathlib import Path

if __name__ == "__main__":  # as a script: this folder's `data` or `run` must not hide other packages
    sys.path[0] = str(Path(__file__).resolve().parents[1])

import importlib
import importlib.util
from collections.abc import Mapping
from typing import Any

from envs.core.atomic import atomic_directory
from envs.core.errors import ConfigError
from roboverse_learn.config.other_commands import NewConfig

TEMPLATES = Path(__file__).parent / "skeletons"
"""Templates, part of the package: a folder for each kind, and what all kinds share."""

_SUFFIX = ".jinja"
_OUTSIDE = ("README.md", "pyproject.toml")
"""Files beside the package; the others are inside."""


def new(config: NewConfig) -> str:
    """Writes a package; returns what to print: its files, and what to do next.

    Raises:
        ConfigError: The folder exists, or the name is taken.
        WriteError: The folder cannot be written.
    """
    folder = Path(config.folder)
    entries = _entry_points(config)
    _refuse_taken(config, folder, entries)
    files = render(config)
    with atomic_directory(folder) as staging:
        for name, text in files.items():
            path = staging / name
            path.parent.mkdir(exist_ok=True)
            path.write_text(text, encoding="utf-8")
    return _next_steps(config, folder, list(files))


def render(config: NewConfig) -> dict[str, str]:
    """Returns the text of each file, by its path in the folder."""
    from jinja2 import Environment, FileSystemLoader, StrictUndefined

    templates = Environment(
        loader=FileSystemLoader(TEMPLATES),
        undefined=StrictUndefined,
        keep_trailing_newline=True,
        trim_blocks=True,
        autoescape=False,
    )
    sources = sorted([*(TEMPLATES / "shared").iterdir(), *(TEMPLATES / config.kind).iterdir()])
    values: Mapping[str, Any] = {
        "name": config.name,
        "module": config.module,
        "class_name": config.class_name,
        "about": f"The {config.kind} {config.name}",
        "entry_points": _entry_points(config),
        "data": any(path.name.endswith(f".xml{_SUFFIX}") for path in sources),
    }
    files = {}
    for path in sources:
        if path.name.endswith(_SUFFIX):
            name = path.name.removesuffix(_SUFFIX)
            place = name if name in _OUTSIDE else f"{config.module}/{name}"
            files[place] = templates.get_template(f"{path.parent.name}/{path.name}").render(values)
    return files


def _entry_points(config: NewConfig) -> list[tuple[str, str, str]]:
    """Returns group, name and target of each entry point."""
    module, cls = config.module, config.class_name
    return {
        "task": [("tasks", config.name, f"{module}.task:{cls}")],
        "policy": [("policies", config.name, f"{module}.policy:{cls}")],
        "robot": [
            ("robots", config.name, f"{module}.robot:ROBOT"),
            ("tasks", f"{cls}Reach", f"{module}.task:{cls}Reach"),
        ],
    }[config.kind]


def _refuse_taken(config: NewConfig, folder: Path, entries: list[tuple[str, str, str]]) -> None:
    """Checks that nothing has the name, and that nothing is in the folder's place.

    Raises:
        ConfigError: Something has, or is.
    """
    if folder.resolve() == Path.cwd():
        raise ConfigError(f"out={folder} is the folder that you are in. Leave out= away, or name a new one.")
    if folder.exists() and not (folder.is_dir() and not any(folder.iterdir())):
        raise ConfigError(
            f"'{folder}' exists, and nothing is overwritten. Choose another folder by out=, or another name."
        )
    registries = {
        "tasks": ("envs.tasks", "TASKS"),
        "policies": ("policies", "POLICIES"),
        "robots": ("envs.robots", "ROBOTS"),
    }
    for group, name, _ in entries:
        module, registry = registries[group]
        if name in getattr(importlib.import_module(module), registry):
            raise ConfigError(
                f"name={config.name}: '{name}' is registered already, see roboverse list {group}. Choose "
                "another name."
            )
    found = importlib.util.find_spec(config.module)
    if found is not None and found.origin is not None:
        raise ConfigError(
            f"name={config.name}: its package would be called '{config.module}', as one that is installed "
            f"here ({found.origin}). Choose another name."
        )


def _next_steps(config: NewConfig, folder: Path, files: list[str]) -> str:
    """Returns what was written, and the commands to go on with."""
    plugin = f"plugins=[{config.module}]"
    task = f"{config.class_name}Reach" if config.kind == "robot" else config.name
    trained = f"policy=act task={task} preset=quick"
    if config.kind == "policy":  # a small network learns at ten times the default rate
        trained = f"policy={config.name} task=PickCube preset=quick train.lr=1e-3 cameras=[all]"
    elsewhere = str(folder) != config.module
    commands = [
        *([f"cd {folder}"] if elsewhere else []),
        f"roboverse check {config.kind}={config.name} {plugin}",
        *([f"roboverse check task={task} {plugin}"] if config.kind == "robot" else []),
        f"roboverse train {trained} {plugin}",
    ]
    return "\n".join(
        [
            f"Written to {folder}: {', '.join(files)}",
            "Next:",
            *(f"  {command}" for command in commands),
            f"After 'pip install --no-deps -e {'.' if elsewhere else folder}', in the same folder, every "
            "command knows it without plugins=.",
        ]
    )


if __name__ == "__main__":
    from roboverse_learn.cli import script

    script("new")
