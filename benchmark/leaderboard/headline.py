"""The board's first screen: entries ranked over one set of tasks, each protocol and level on its own."""

from collections.abc import Mapping, Sequence
from contextlib import suppress
from typing import Any

from benchmark.leaderboard.standings import PROTOCOLS, standings
from benchmark.statistics import mean_of_rates
from envs.core.errors import RoboVerseError
from envs.tasks import TASKS
from envs.tasks.suites import SUITES, suite_tasks

MIN_EPISODES = 100
"""Test episodes that a cell needs to count in a rank: their 95 % interval is at most 20 points wide."""

_PLACE = ("protocol", "protocol_seed", "simulator", "renderer")

type Board = dict[str, Any]


def headline(
    sections: Sequence[Mapping[str, Any]],
    entries: Mapping[str, Mapping[str, Any]],
    reference: Mapping[str, Any],
) -> list[Board]:
    """Returns the rankings, the one with most cells first.

    A board has the entries that learned from the same source, demonstrations or reward, and were tested
    where they were trained, in tasks of one suite: those of the paper's table, or those whose names are the
    same up to the last slash, such as ``libero/goal``, or of several such families that are one registered
    suite, such as ``grasp/colours``. A task without a slash is of the largest suite that has it. Only the
    tasks' own scenes count.

    Args:
        sections: Those of :func:`benchmark.leaderboard.build.build`.
        entries: Every entry by its ``id``.
        reference: The paper's numbers, whose tasks are the first suite.

    Returns:
        Boards of plain values: where they were measured, ``learned_from``, ``suite``, ``tasks`` and
        ``protocols``, of ``"A"`` and ``"B"`` to tested level (as text) to rows. A row has ``entry``,
        ``rank``, ``mean`` with its interval, ``missing``, ``too_few`` and ``cells`` by task. It is ranked by
        its mean over all tasks of the board, each of :data:`MIN_EPISODES` or more; without that, mean and
        rank are None and the tasks that it lacks are named.
    """
    table = list(dict.fromkeys(row["task"] for row in reference["rows"]))
    joined = _suites_of_families()
    found: dict[tuple[Any, ...], dict[str, Any]] = {}
    for section in _newest(sections):
        for protocol, all_series in standings(section).items():
            for series in all_series:
                if series["entry"] is None or series["transferred_from"] is not None:
                    continue
                entry = entries[series["entry"]]
                suite = _suite(section["task"], table, joined)
                place = tuple(section[key] for key in _PLACE)
                key = (*place, entry["learned_from"], suite)
                cells = found.setdefault(key, {name: {} for name in PROTOCOLS})[protocol]
                for level, cell in series["cells"].items():
                    own = cells.setdefault(level, {}).setdefault(series["entry"], {})
                    own[section["task"]] = _shown(cell["test"], section["id"])
    boards = [_board(key, cells, table) for key, cells in sorted(found.items())]
    return sorted(boards, key=_order)


def _newest(sections: Sequence[Mapping[str, Any]]) -> list[Mapping[str, Any]]:
    """Returns the sections of the tasks' own scenes, one of each task and place.

    Where a task's horizon was changed, that is the section with the newest result: episodes of another length
    are not ranked with it.
    """
    found: dict[tuple[Any, ...], Mapping[str, Any]] = {}
    for section in sections:
        if section["title"] == section["task"]:  # neither options nor a changed scene
            key = (section["task"], *(section[name] for name in _PLACE))
            found[key] = max(found.get(key, section), section, key=_newest_result)
    return list(found.values())


def _newest_result(section: Mapping[str, Any]) -> str:
    return max(run["created"] for row in section["rows"] for run in row["runs"])


def _suite(task: str, table: Sequence[str], joined: Mapping[str, str]) -> str:
    if task in table:
        return "RoboVerse"
    return joined.get(_family(task)) or task.rpartition("/")[0] or "other tasks"


def _family(task: str) -> str:
    """Returns the part of a task's name before its last slash; a task without one is a family by itself."""
    return task.rpartition("/")[0] or task


def _suites_of_families() -> dict[str, str]:
    """Maps each family of tasks to the smallest suite that has all of it and more, where there is one.

    A family that is a suite by itself, such as ``libero/goal`` in the suites ``libero_goal`` and ``libero``,
    is not among them. A task without a slash is mapped to the largest suite that has it: the benchmark that
    it is from, and not a selection of someone's.
    """
    families: dict[str, set[str]] = {}
    for task in TASKS:
        families.setdefault(_family(task), set()).add(task)
    suites: dict[str, set[str]] = {}
    for name in SUITES:
        with suppress(RoboVerseError):  # of a package that is damaged, or lacks an extra
            suites[name] = set(suite_tasks(name))
    found = {}
    for family, tasks in families.items():
        is_task = tasks == {family}
        around = [name for name in suites if tasks <= suites[name]]
        around.sort(key=lambda name: (len(suites[name]), name), reverse=is_task)
        if around and (is_task or suites[around[0]] != tasks):
            found[family] = around[0]
    return found


def _shown(cell: Mapping[str, Any], section: str) -> dict[str, Any]:
    names = ("success_rate", "ci_low", "ci_high", "episodes")
    return {name: cell[name] for name in names} | {"section": section}


def _board(key: tuple[Any, ...], cells: Mapping[str, Mapping[str, Any]], table: Sequence[str]) -> Board:
    *place, learned_from, suite = key
    seen = {
        task for levels in cells.values() for rows in levels.values() for row in rows.values() for task in row
    }
    tasks = list(table) if suite == "RoboVerse" else sorted(seen)
    return dict(zip(_PLACE, place, strict=True)) | {
        "learned_from": learned_from,
        "suite": suite,
        "tasks": tasks,
        "min_episodes": MIN_EPISODES,
        "protocols": {
            protocol: {level: _ranked(rows, tasks) for level, rows in sorted(levels.items())}
            for protocol, levels in cells.items()
        },
    }


def _ranked(rows: Mapping[str, Mapping[str, Any]], tasks: Sequence[str]) -> list[dict[str, Any]]:
    """Returns the rows of one table: the ranked ones by their mean, then those with most tasks."""
    table = [_row(entry, cells, tasks) for entry, cells in rows.items()]
    means = [row["mean"]["success_rate"] for row in table if row["mean"]]
    for row in table:
        if row["mean"]:
            row["rank"] = 1 + sum(mean > row["mean"]["success_rate"] for mean in means)
    return sorted(
        table,
        key=lambda row: (row["rank"] is None, row["rank"] or -len(row["cells"]), row["entry"]),
    )


def _row(entry: str, cells: Mapping[str, Mapping[str, Any]], tasks: Sequence[str]) -> dict[str, Any]:
    missing = [task for task in tasks if task not in cells]
    too_few = [task for task in tasks if task in cells and cells[task]["episodes"] < MIN_EPISODES]
    mean = None
    if not missing and not too_few:
        rates = [(c["success_rate"], c["ci_low"], c["ci_high"]) for c in (cells[task] for task in tasks)]
        mean = dict(zip(("success_rate", "ci_low", "ci_high"), mean_of_rates(rates), strict=True))
    return {
        "entry": entry,
        "rank": None,
        "mean": mean,
        "missing": missing,
        "too_few": too_few,
        "cells": {task: cells[task] for task in tasks if task in cells},
    }


def _order(board: Board) -> tuple[Any, ...]:
    """Orders boards: the paper's tasks first, then from demonstrations, then by the number of cells."""
    rows = [row for levels in board["protocols"].values() for table in levels.values() for row in table]
    place = [str(board[key]) for key in _PLACE]
    return (
        board["suite"] != "RoboVerse",
        board["learned_from"] != "demonstrations",
        -sum(len(row["cells"]) for row in rows),
        board["suite"],
        place,
    )
