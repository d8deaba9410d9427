"""Labels of a changed scene and of its materials, in names of folders and files and in results."""

import re
from collections.abc import Mapping
from pathlib import Path
from typing import Any

from envs.core.fingerprint import digest
from envs.spec import EnvSpec


def scenario_name(changes: Mapping[str, Any]) -> str:
    """Returns the label of changes of a scene in the name of a folder or a file."""
    return f"scenario-{digest(changes)}"


def fit_for_a_file(text: str) -> str:
    """Returns a text as a part of a file name: hyphens take the place of signs that a result refuses."""
    return re.sub(r"[^A-Za-z0-9._+=-]+", "-", text)


def folder_name(materials: str) -> str:
    """Returns the materials in the name of a dataset: ``+images`` for ``+somewhere/images``."""
    return "+" * materials.startswith("+") + Path(materials).name.removeprefix("+")


def recorded_materials(materials: str) -> str:
    """Returns the materials as a result records them: by folder name and content; empty for built-in ones.

    Raises:
        ConfigError: The folder does not exist, has too few images, or one that cannot be read.
    """
    from envs.randomization.materials import MaterialLibrary

    if not materials:
        return ""
    return f"{folder_name(materials)}-{MaterialLibrary.chosen(materials).digest()[:8]}"


def varied_part(env: EnvSpec) -> str:
    """Returns the part of a name that says what varies: ``level0``, ``camera-alone``."""
    return f"{env.only}-alone" if env.only else f"level{env.level}"
