"""The Git checkout that code lies in: which commit made a result."""

import subprocess
from pathlib import Path


def git(folder: Path, *arguments: str) -> str | None:
    """Returns what Git prints in a folder; None where it fails or is not installed."""
    try:
        done = subprocess.run(
            ["git", "-C", str(folder), *arguments], capture_output=True, text=True, timeout=30, check=True
        )
    except (OSError, subprocess.SubprocessError):
        return None
    return done.stdout.strip()


def is_tracked(file: Path) -> bool:
    """Returns whether a file is of the checkout around it: an installed package may lie in another's."""
    return bool(git(file.parent, "ls-files", file.name))


def git_sha(folder: Path | None = None) -> str | None:
    """Returns the commit of the checkout that holds ``folder`` (that of this code by default).

    It ends in ``+`` if tracked files differ from the commit, or if Git cannot say whether they do. Changes in
    ``results/`` do not count: runs write these files, and no result depends on them. It is None outside a
    checkout.
    """
    # An installed package can lie inside somebody else's checkout, whose commit says nothing of it.
    if folder is None and not is_tracked(Path(__file__)):
        return None
    here = folder or Path(__file__).parent
    found = git(here, "rev-parse", "--show-toplevel", "HEAD")  # fails where there are no files of a commit
    if found is None:
        return None
    changed = git(here, "status", "--porcelain", "-uno", "--", ":/", ":(top,exclude)results")
    return found.splitlines()[-1] + "+" * (changed != "")
