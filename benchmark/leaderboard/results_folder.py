"""A folder of results: what a board makes of it, the results in it, and what other folders are."""

import logging
import os
import re
from collections.abc import Sequence
from pathlib import Path

from benchmark.chain_results import FILE as CHAINS_NAME
from benchmark.leaderboard.rows import Entry
from benchmark.leaderboard.video_rule import KEEP_FILE
from benchmark.records import Result
from benchmark.results import read_result, result_path
from benchmark.suites import FOLDER
from envs.core.errors import ForeignFileError, ResultError, UnregisteredError

JSON_NAME, MARKDOWN_NAME, HTML_NAME = "leaderboard.json", "leaderboard.md", "leaderboard.html"
STUDIES_MARKDOWN_NAME, STUDIES_HTML_NAME = "studies.md", "studies.html"
INSTRUCTIONS_MARKDOWN_NAME, INSTRUCTIONS_HTML_NAME = "instructions.md", "instructions.html"
PLOTS = "plots"

TABLES = (JSON_NAME, CHAINS_NAME, "robots.json", "tasks.json")
"""Files of the folder that are no results: our own, and the tables of experts by robot and by task."""

_OWN = {
    *(*TABLES, KEEP_FILE, FOLDER, PLOTS, MARKDOWN_NAME, HTML_NAME),
    *(STUDIES_MARKDOWN_NAME, STUDIES_HTML_NAME, INSTRUCTIONS_MARKDOWN_NAME, INSTRUCTIONS_HTML_NAME),
}
_PROTOCOL = re.compile(r"v\d+")

_SIGNS = {"meta/info.json": "dataset", "manifest.json": "run", "model.safetensors": "checkpoint"}
"""A file of a folder, and what the folder that has it is."""

_SHOWN_ERRORS = 10

log = logging.getLogger(__name__)


def load_results(results_dir: Path) -> list[Entry]:
    """Reads every result of a folder; one of a channel that is not registered here is left out.

    Args:
        results_dir: Folder of ``<protocol>/<task>/<policy>/<run>.json``.

    Returns:
        Paths relative to the folder, and what they hold; none of a folder that is empty.

    Raises:
        ResultError: The folder is absent, is no folder of results, or a file in it is not a valid result in
            its place; every such file is named.
    """
    if not results_dir.is_dir():
        raise ResultError(
            f"There is no folder of results '{results_dir}'. Evaluate a checkpoint first: roboverse evaluate "
            "checkpoint=<folder>."
        )
    check_results_folder(results_dir)
    entries: list[Entry] = []
    problems: list[ResultError] = []
    left_out: list[ResultError] = []
    for path in _result_files(results_dir):
        try:
            result = read_result(path)
            expected = result_path(results_dir, result)
            if path != expected:
                raise ResultError(f"Results file '{path}' is in the wrong place; it belongs at '{expected}'.")
        except UnregisteredError as error:
            left_out.append(error)
        except ResultError as error:
            problems.append(error)
        else:
            entries.append((path.relative_to(results_dir).as_posix(), result))
    if not entries and not problems and _names_in(results_dir) and not _has_ours(results_dir):
        raise _other_folder(results_dir)
    if problems:
        raise ResultError(
            f"No leaderboard was written, because of {len(problems)} results file(s):\n{_shown(problems)}"
        )
    if left_out:
        log.warning("The leaderboard is without %d results file(s):\n%s", len(left_out), _shown(left_out))
    return entries


def _shown(errors: Sequence[ResultError]) -> str:
    """Returns the first of several errors, one a line."""
    more = len(errors) - _SHOWN_ERRORS
    return "\n".join(map(str, errors[:_SHOWN_ERRORS])) + (f"\n… and {more} more." if more > 0 else "")


def check_results_folder(results_dir: Path) -> None:
    """Checks that a folder is one of results: absent, without JSON, or with a result or what a board leaves.

    Raises:
        ResultError: Another folder is the one of its results, or it has JSON files of other things alone.
    """
    if not results_dir.is_dir() or _has_ours(results_dir):
        return
    files = _result_files(results_dir)
    for path in files:
        try:
            root = _root_of(path, read_result(path))
        except ForeignFileError:
            continue
        except ResultError:
            return  # a damaged one
        if root is not None:
            raise ResultError(
                f"'{results_dir}' is not a folder of results: '{root}' is. Give results_dir={root} instead."
            )
        return
    if files:
        raise _other_folder(results_dir)


def _result_files(results_dir: Path) -> list[Path]:
    """Returns the files that are results, or should be."""
    others = [results_dir / name for name in TABLES]
    return [
        path
        for path in sorted(results_dir.rglob("*.json"))
        if not (path.name.startswith(".") or path in others or results_dir / FOLDER in path.parents)
    ]


def _root_of(path: Path, result: Result) -> Path | None:
    """Returns the folder of results in which a result's path is right; None if it is right in none."""
    inside = result_path(Path(), result).parts
    if path.absolute().parts[-len(inside) :] != inside:
        return None
    root = path.absolute().parents[len(inside) - 1]
    return root if path.is_absolute() else Path(os.path.relpath(root))


def _names_in(folder: Path) -> list[str]:
    return sorted(path.name for path in folder.iterdir() if not path.name.startswith("."))


def _has_ours(folder: Path) -> bool:
    """Whether a folder has a protocol's results, or what a board leaves."""
    return any(name in _OWN or _PROTOCOL.fullmatch(name) for name in _names_in(folder))


def _other_folder(folder: Path) -> ResultError:
    return ResultError(
        f"'{folder}' is not a folder of results: {_looks_like(folder, _names_in(folder))}. Nothing was "
        "changed in it. Give the folder that roboverse evaluate writes to, which is 'results' where "
        "results_dir= is left out."
    )


def _looks_like(folder: Path, names: Sequence[str]) -> str:
    """Returns what a folder seems to be: ``it holds datasets, such as 'datasets/PickCube/demos'``."""
    for below, folders, _ in os.walk(folder):
        folders.sort()
        for sign, kind in _SIGNS.items():
            if (Path(below) / sign).is_file():
                return f"it is a {kind}" if Path(below) == folder else f"it holds the {kind} '{below}'"
    shown = ", ".join(f"'{name}'" for name in names[:3]) + (", …" if len(names) > 3 else "")
    return f"it holds {shown} and no results"
