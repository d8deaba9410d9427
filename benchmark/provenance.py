"""Provenance of a result: commit, versions, machine, command. Nothing private.

A result is published, so host names and folders of a machine are left out of it.
"""

import os
import platform
import shlex
from collections.abc import Mapping, Sequence
from datetime import UTC, datetime
from functools import cache
from importlib.metadata import PackageNotFoundError, version
from pathlib import Path
from typing import Any

from benchmark.records import Git, Machine
from envs.core.git import git_sha
from envs.core.machine import num_cores

PACKAGES = (
    "roboverse-learn",
    "lerobot",
    "torch",
    "mujoco",
    "mujoco-warp",
    "warp-lang",
    "gymnasium",
    "numpy",
    "robosuite",
    "sapien",
    "pybullet",
    "newton",
    "genesis-world",
    "metaworld",
)
"""Packages whose version can change the outcome of an episode."""


def now() -> str:
    """Returns the time of day as results files write it."""
    return datetime.now(UTC).strftime("%Y-%m-%dT%H:%M:%SZ")


def package_versions() -> dict[str, str]:
    """Returns the versions of Python and of every installed package of :data:`PACKAGES`."""
    return dict(_package_versions())


@cache
def _package_versions() -> dict[str, str]:
    """Reads the packages' metadata once in a process: that takes as long as 15 images of 64×64."""
    versions = {"python": platform.python_version()}
    for name in PACKAGES:
        try:
            versions[name] = version(name)
        except PackageNotFoundError:
            continue
    return versions


def git_state(folder: Path | None = None) -> Git | None:
    """Returns the commit of the checkout that this code runs from, or None outside one.

    Args:
        folder: A folder of the checkout; the one of this file when None.
    """
    sha = git_sha(folder)
    return None if sha is None else Git(sha=sha.removesuffix("+"), dirty=sha.endswith("+"))


def machine(device: str = "cpu") -> Machine:
    """Returns what the evaluation ran on.

    Args:
        device: Torch device of the policy; a GPU is recorded by its model's name.
    """
    name = "cpu"
    if device != "cpu":
        import torch

        name = torch.cuda.get_device_name(device) if device.startswith("cuda") else device
    return Machine(device=name, cpu_count=num_cores())


def command_line(arguments: Sequence[str]) -> str:
    """Returns the command as one would type it, without the folders of this machine.

    Args:
        arguments: ``sys.argv``.
    """
    program, *rest = arguments
    command = ["python", _portable(program)] if program.endswith(".py") else [Path(program).name]
    return shlex.join([*command, *(_portable(argument) for argument in rest)])


def portable(values: Any) -> Any:
    """Returns a configuration with every absolute path made relative to where the command ran.

    Args:
        values: Plain JSON values, or paths, nested.
    """
    if isinstance(values, Mapping):
        return {str(key): portable(value) for key, value in values.items()}
    if isinstance(values, list | tuple):
        return [portable(value) for value in values]
    if isinstance(values, str | Path):
        return _portable(str(values))
    return values


def _portable(text: str) -> str:
    """Makes a path, or the path in ``key=path``, relative; one outside keeps only its last name."""
    key, separator, value = text.rpartition("=")
    if not os.path.isabs(value):
        return text
    path = Path(value)
    inside = path.is_relative_to(Path.cwd())
    return key + separator + (str(path.relative_to(Path.cwd())) if inside else f".../{path.name}")
