"""Tells a folder that is a file before anything is collected, trained or evaluated."""

from pathlib import Path
from typing import Any

from envs.core.errors import ConfigError

_KEYS = ("dataset", "datasets_dir", "run", "runs_dir", "results_dir", "out")


def check_folders(config: Any) -> None:
    """Refuses a configuration in which a folder is a file, or would lie in a file.

    Raises:
        ConfigError: A file is where a folder is meant.
    """
    for key in _KEYS:
        given = getattr(config, key, "")
        file = file_in_place_of_folder(Path(given)) if given else None
        if file is not None:
            raise ConfigError(f"{key}={given}: {not_a_folder(file)}")


def file_in_place_of_folder(path: Path) -> Path | None:
    """Returns what forbids that ``path`` is a folder: a file of this name, or of a folder's above it."""
    return next((each for each in (path, *path.parents) if each.exists() and not each.is_dir()), None)


def not_a_folder(file: Path) -> str:
    """Says that a file is where a folder is meant, and what to do."""
    return f"'{file}' is a file, not a folder. Name another folder, or move the file away."
