"""What is said where ``run=`` names a folder that is no run yet: a new one begins; is it misspelt?"""

import difflib
import os
from pathlib import Path

from roboverse_learn.commands.run_folder import CONFIG_FILE

_CLOSE = 0.75
"""Least similarity of a misspelt name, as :func:`difflib.get_close_matches` counts it."""


def new_run_words(run: str) -> str:
    """Returns a sentence where a new run begins in a folder that is named, with the run that may be meant.

    Args:
        run: The folder; empty where none is named.

    Returns:
        Nothing where no folder is named, or where it is a run already.
    """
    folder = Path(run)
    if not run or (folder / CONFIG_FILE).exists():
        return ""
    near = _near(folder)
    hint = f" Did you mean '{near}'?" if near else ""
    return f"run={run}: there is no run yet, so a new one begins.{hint}"


def _near(folder: Path) -> Path | None:
    """Returns a run whose path differs from a folder's by the spelling of the first part that is missing."""
    base = next(each for each in (folder, *folder.parents) if each.is_dir())
    first, *others = folder.relative_to(base).parts or ("",)
    try:
        names = os.listdir(base)
    except PermissionError:
        return None
    runs = [name for name in names if os.path.isfile(base.joinpath(name, *others, CONFIG_FILE))]
    close = difflib.get_close_matches(first, filter(lambda name: not _numbered(name, first), runs), 1, _CLOSE)
    return base.joinpath(close[0], *others) if close else None


def _numbered(one: str, other: str) -> bool:
    """Whether two names differ by their digits alone, as those of several seeds, which are meant so."""
    letters = ["".join(sign for sign in name if not sign.isdigit()) for name in (one, other)]
    return letters[0] == letters[1]
