"""A folder of pictures as materials: whether it can be used, and what it is called in names and results."""

from pathlib import Path


def check_materials(materials: str) -> None:
    """Reads a folder of materials, so that a wrong one is told before anything is made.

    Args:
        materials: The folder, with ``+`` before it or without; empty for the built-in materials.

    Raises:
        ConfigError: It does not exist, holds too few pictures, or one that cannot be read.
    """
    from envs.randomization.materials import MaterialLibrary
    from envs.randomization.splits import load_split

    if materials:
        load_split("train", MaterialLibrary.chosen(materials))


def folder_name(materials: str) -> str:
    """Returns ``+pictures`` for ``+somewhere/pictures``: where a folder lies is this machine's affair."""
    return "+" * materials.startswith("+") + Path(materials).name.removeprefix("+")


def recorded_materials(materials: str) -> str:
    """Returns how a result names materials: by their folder and their content; empty for the built-in ones.

    Raises:
        ConfigError: as :func:`check_materials`.
    """
    from envs.randomization.materials import MaterialLibrary

    if not materials:
        return ""
    return f"{folder_name(materials)}-{MaterialLibrary.chosen(materials).digest()[:8]}"
