"""On which page of a board a result is shown."""

import json
from collections.abc import Collection, Iterator, Mapping
from pathlib import Path
from typing import Any

from benchmark.leaderboard.entries import STUDY

BOARD_PAGE, STUDIES_PAGE = "html", "studies html"
"""Kinds of what :func:`benchmark.leaderboard.build.write` returns."""


def pages_of(board: Path, paths: Collection[str]) -> list[str]:
    """Returns the pages that some results are on, the board first; none if it cannot be read.

    A study is on the studies' page. Entries, baselines and the tasks of suites are on the board.

    Args:
        board: The leaderboard's JSON file.
        paths: Paths of the results, relative to the folder of results.

    Returns:
        :data:`BOARD_PAGE`, :data:`STUDIES_PAGE`, or both.
    """
    try:
        places = set(_places(json.loads(board.read_text(encoding="utf-8")), {*paths}))
    except (OSError, ValueError, TypeError, LookupError):  # it is gone, or damaged
        return []
    return [page for page in (BOARD_PAGE, STUDIES_PAGE) if page in places]


def _places(board: Mapping[str, Any], paths: Collection[str]) -> Iterator[str]:
    rows = [row for section in board["sections"] for row in section["rows"]]
    for row in rows:
        if any(run["path"] in paths for run in row["runs"]):
            yield STUDIES_PAGE if row["kind"] == STUDY else BOARD_PAGE
    suites = [row for suite in board["suites"] for row in suite["rows"]]
    if any(task["path"] in paths for row in suites for task in row["tasks"]):
        yield BOARD_PAGE
