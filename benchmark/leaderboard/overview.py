"""Overview of all tasks: success at every level of policies trained at each level."""

from collections import Counter
from collections.abc import Iterable, Mapping, Sequence
from functools import partial
from itertools import chain
from typing import Any

type Table = dict[str, Any]

_PLACE = ("protocol", "protocol_seed", "simulator", "renderer")


def overview(sections: Iterable[Mapping[str, Any]]) -> list[Table]:
    """Returns a table per protocol, simulator and renderer in which policies learned two tasks or more.

    It holds policies that learned from demonstrations of the expert in the tasks' own scenes and were tested
    where they were trained. Of several rows of a policy and training level it shows the one with the most
    test episodes, then most demonstrations, then most gradient steps, then that of the recipe with the most
    runs, then the newest: never the best.

    Args:
        sections: Those of :func:`benchmark.leaderboard.build`.

    Returns:
        Tables of plain values, the longest first: where they were measured, ``train_levels`` and
        ``test_levels``, and ``rows`` of a task and a policy. A row has ``trained``, a mapping of training
        level (as text) to a mapping of test level (as text) to ``success_rate``, ``ci_low``, ``ci_high`` and
        ``episodes``, and ``trainings``, of training level to ``demonstrations``, ``steps`` and ``seeds``.
        There is no mean: budgets differ from cell to cell.
    """
    places: dict[tuple[Any, ...], list[Mapping[str, Any]]] = {}
    for section in sections:
        if section["title"] == section["task"]:  # neither options nor a changed scene
            places.setdefault(tuple(section[key] for key in _PLACE), []).append(section)
    tables = []
    for place, found in places.items():
        made: Counter[str] = Counter()
        for row in chain.from_iterable(section["rows"] for section in found):
            if row["recipe"]:
                made[row["recipe"]] += len(row["runs"])
        rows = [row for section in found for row in _rows(section, made)]
        if len({row["task"] for row in rows}) > 1:
            tables.append(dict(zip(_PLACE, place, strict=True)) | _table(rows))
    return sorted(tables, key=lambda table: -len(table["rows"]))


def _rows(section: Mapping[str, Any], made: Mapping[str, int]) -> list[Table]:
    """Returns one row per policy of a task; ``made`` has the number of runs of each recipe."""
    found: dict[tuple[str, int], list[Mapping[str, Any]]] = {}
    for row in section["rows"]:
        here = (
            row["demonstrations"]
            and not (row["transferred_from"] or row.get("source"))
            and row["train_level"] is not None
        )
        if here and _tested(row):
            found.setdefault((row["policy"], row["train_level"]), []).append(row)
    place = {"task": section["task"], "section": section["id"]}
    by_policy: dict[str, Table] = {}
    for (policy, level), rows in sorted(found.items()):
        shown = max(rows, key=partial(_weight, made))
        own = by_policy.setdefault(policy, place | {"policy": policy, "trained": {}, "trainings": {}})
        own["trained"][str(level)], own["trainings"][str(level)] = _tested(shown), _training(shown)
    return list(by_policy.values())


def _weight(made: Mapping[str, int], row: Mapping[str, Any]) -> tuple[Any, ...]:
    episodes = sum(cell["episodes"] for cell in _tested(row).values())
    newest = max(run["created"] for run in row["runs"])
    return episodes, row["demonstrations"], _steps(row), made.get(row["recipe"], 0), newest


def _steps(row: Mapping[str, Any]) -> int:
    """Returns the most training steps of a row's runs; 0 where none says how many it had."""
    return max(run["checkpoint"]["step"] or 0 for run in row["runs"])


def _training(row: Mapping[str, Any]) -> Table:
    """Returns what a row was trained with."""
    return {"demonstrations": row["demonstrations"], "steps": _steps(row), "seeds": len(row["seeds"])}


def _tested(row: Mapping[str, Any]) -> dict[str, Table]:
    """Returns the cells of the test split by level."""
    names = ("success_rate", "ci_low", "ci_high", "episodes")
    return {
        str(cell["level"]): {name: cell[name] for name in names}
        for cell in row["cells"]
        if cell["split"] == "test" and cell["level"] is not None
    }


def _table(rows: Sequence[Table]) -> Table:
    trained = [level for row in rows for level in row["trained"]]
    tested = [level for row in rows for cells in row["trained"].values() for level in cells]
    levels = {"train_levels": sorted(set(trained)), "test_levels": sorted(set(tested))}
    return levels | {"rows": rows}
