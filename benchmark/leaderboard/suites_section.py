"""Suites on the board: one row an evaluation, with the mean over its tasks, and each task below it."""

import logging
from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import Any

from benchmark.leaderboard.labels import settings_of
from benchmark.protocol import Cell
from benchmark.records import Result
from benchmark.suites import FOLDER, SuiteResult, read_suite, suite_path, summarize_suite
from envs.core.errors import ResultError, UnregisteredError

log = logging.getLogger(__name__)

MOST_SECTIONS = 12
"""Tasks of a suite that also have a section each; those of a larger suite are in its rows alone."""

_GONE = "its result is no longer in this folder"


def read_suites(results_dir: Path) -> list[SuiteResult]:
    """Returns the suites' files of a folder of results, sorted by their paths.

    Raises:
        ResultError: One is no such file, or lies in the wrong place.
    """
    found = []
    for path in sorted((results_dir / FOLDER).rglob("*.json")):
        if path.name.startswith("."):
            continue
        try:
            suite = read_suite(path)
        except UnregisteredError as error:
            log.warning("The leaderboard is without a row of a suite: %s", error)
            continue
        expected = suite_path(results_dir, suite)
        if path != expected:
            raise ResultError(f"Results file '{path}' is in the wrong place; it belongs at '{expected}'.")
        found.append(suite)
    return found


def without_section(suites: Sequence[SuiteResult]) -> set[str]:
    """Returns the paths of the results that are shown in the row of a suite alone.

    Those of a large suite are, and those of another benchmark's protocol, which nothing is compared with.
    """
    alone = [suite for suite in suites if suite.named_protocol or len(suite.tasks) > MOST_SECTIONS]
    return {path for suite in alone for path in suite.results.values()}


def suite_sections(suites: Sequence[SuiteResult], results: Mapping[str, Result]) -> list[dict[str, Any]]:
    """Returns a section for each suite, its rows by their mean success, best first.

    Args:
        suites: Evaluations of suites.
        results: Results by their path, relative to the folder of results.

    Returns:
        Plain values: ``suite``, ``columns`` (cells of the test split) and ``rows``. A row has what was
        evaluated, ``cells`` (the mean over tasks, by column, or None) and ``tasks``, each with its own
        cells or the ``reason`` why it has none.
    """
    by_suite: dict[str, list[dict[str, Any]]] = {}
    columns: dict[str, dict[Cell, None]] = {}
    for suite in suites:
        own = {task: results[path] for task, path in suite.results.items() if path in results}
        if own:
            row, cells = _row(suite, own)
            by_suite.setdefault(suite.suite, []).append(row)
            columns.setdefault(suite.suite, {}).update(dict.fromkeys(cells))
    return [_section(name, rows, list(columns[name])) for name, rows in sorted(by_suite.items())]


def _section(name: str, rows: list[dict[str, Any]], columns: list[Cell]) -> dict[str, Any]:
    columns.sort(key=lambda cell: (cell.level is None, cell.level, cell.only or ""))
    for row in rows:
        means = row.pop("means")
        row["cells"] = [means.get(cell) for cell in columns]
        for task in row["tasks"]:
            own = task.pop("by_cell")
            task["cells"] = [own.get(cell) for cell in columns]
    rows.sort(key=lambda row: (-_mean(row["cells"]), row["policy"], row["run"]))
    shown = [{"level": cell.level, "only": cell.only} for cell in columns]
    return {"suite": name, "columns": shown, "rows": rows}


def _row(suite: SuiteResult, results: Mapping[str, Result]) -> tuple[dict[str, Any], list[Cell]]:
    first = next(iter(results.values()))
    means = {each.cell: each.to_json() for each in summarize_suite(results) if each.cell.split == "test"}
    row = {
        "policy": suite.policy,
        "run": suite.run,
        "created": suite.created,
        "protocol": suite.named_protocol or suite.protocol.version,
        "episodes_per_cell": suite.protocol.episodes,
        "simulator": first.env.simulator,
        "renderer": first.env.renderer,
        "is_baseline": first.checkpoint.hash is None,
        "train_level": first.train_level,
        "recipe": first.recipe or None,
        # A protocol's name says its own.
        "settings": "" if suite.named_protocol else ", ".join(sorted(settings_of(first.env))),
        "num_tasks": len(suite.tasks),
        "num_evaluated": len(results),
        "means": means,
        "tasks": [_task(task, suite, results) for task in suite.tasks],
    }
    return row, list(means)


def _task(task: str, suite: SuiteResult, results: Mapping[str, Result]) -> dict[str, Any]:
    if task not in results:
        return {"task": task, "path": None, "reason": suite.failed.get(task, _GONE), "by_cell": {}}
    names = ("success_rate", "ci_low", "ci_high", "episodes", "successes")
    cells = {
        each.cell: {name: getattr(each, name) for name in names}
        for each in results[task].cells()
        if each.cell.split == "test"
    }
    return {"task": task, "path": suite.results[task], "reason": None, "by_cell": cells}


def _mean(cells: Sequence[Mapping[str, Any] | None]) -> float:
    rates = [cell["success_rate"] for cell in cells if cell]
    return sum(rates) / len(rates) if rates else 0.0
