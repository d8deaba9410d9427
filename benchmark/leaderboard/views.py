"""What the templates of the pages need beside the board's values: columns, rows, charts, filters."""

from collections import Counter
from collections.abc import Iterable, Mapping, Sequence
from typing import Any

from benchmark.leaderboard.axis_chart import axis_bars, axis_chart
from benchmark.leaderboard.curve_chart import curve_charts
from benchmark.leaderboard.demonstrations_chart import demonstrations_chart
from benchmark.leaderboard.entries import STUDY
from benchmark.leaderboard.headline import MIN_EPISODES
from benchmark.leaderboard.labels import entry_name, name_of, origin
from benchmark.leaderboard.level_chart import MAX_LINES, level_chart, line, series_lines
from benchmark.leaderboard.standings import standings
from benchmark.learning_curves import published_times

type View = dict[str, Any]


def board_view(board: Mapping[str, Any]) -> View:
    """Returns the view of the board's page: rankings, and the entries of every task."""
    entries, reference = board["entries"], board["reference"]
    places = [_board_place(section, entries, reference) for section in board["sections"]]
    table = list(dict.fromkeys(row["task"] for row in reference["rows"]))
    tasks = _by_task([place for place in places if place["kinds"] - {STUDY}], table)
    policies = {entry["policy"] for entry in entries.values()}
    policies |= {
        series["policy"] for place in places for each in place["protocols"] for series in each["series"]
    }
    boards = [_ranking(each, reference) for each in board["headline"]]
    names = list(
        dict.fromkeys([task for each in boards for task in each["tasks"]] + [t["title"] for t in tasks])
    )
    return {
        "boards": boards,
        "suites": board["suites"],
        "chains": board.get("chains", []),
        "tasks": tasks,
        "task_names": names,
        "policy_names": sorted(policies),
        "entries": entries,
        "reference": reference,
        "latest": board["latest"],
        "min_episodes": MIN_EPISODES,
        "num_studies": sum(row["kind"] == STUDY for section in board["sections"] for row in section["rows"]),
        "shown_level": _shown_level(boards),
        "num_instructed": len(board.get("instructions", [])),
    }


def studies_view(board: Mapping[str, Any]) -> View:
    """Returns the view of the studies' page; entries are shown beside the studies of their policy."""
    places = [_studies_place(section, board) for section in board["sections"]]
    table = list(dict.fromkeys(row["task"] for row in board["reference"]["rows"]))
    return {
        "tasks": _by_task([place for place in places if STUDY in place["kinds"]], table),
        "overview": board["overview"],
        "entries": board["entries"],
        "reference": board["reference"],
        "latest": board["latest"],
        "min_episodes": MIN_EPISODES,
    }


def _by_task(places: Iterable[View], table: Sequence[str]) -> list[View]:
    """Returns the places of every task and its options together, the tasks of the paper's table first."""
    found: dict[str, list[View]] = {}
    for place in places:
        found.setdefault(place["title"], []).append(place)
    for of in found.values():
        number = Counter(place["name"] for place in of)
        for place in of:
            if number[place["name"]] > 1:
                place["name"] += f", {place['section']['max_episode_steps']} steps"
    tasks = [
        {"title": title, "places": sorted(of, key=lambda place: -place["num_native"])}
        for title, of in found.items()
    ]
    order = {task: index for index, task in enumerate(table)}
    return sorted(tasks, key=lambda task: order.get(task["title"], len(table)))


def _shown_level(boards: Sequence[View]) -> str:
    """Returns the level that the page opens with: the hardest that the first board was tested at."""
    levels = [level for board in boards[:1] for each in board["protocols"] for level in each["levels"]]
    return max(levels, default="0")


def _ranking(board: Mapping[str, Any], reference: Mapping[str, Any]) -> View:
    """Returns one ranking: its protocols, and the paper's numbers beside B."""
    trained = board["protocols"]["B"]
    names = ["A"] if set(trained) <= {"0"} and set(board["protocols"]["A"]) <= {"0"} else ["A", "B"]
    tables = {name: _all_levels(board, name) for name in names}
    return {
        **board,
        "lacking": {
            level: [(name, row) for name in names for row in tables[name][level] if not row["mean"]]
            for level in tables["A"]
        },
        "protocols": [
            {
                "name": name,
                "levels": {
                    level: {
                        "rows": rows,
                        "papers": _papers(reference, board, level) if name == "B" else [],
                    }
                    for level, rows in tables[name].items()
                },
            }
            for name in names
        ],
    }


def _all_levels(board: Mapping[str, Any], name: str) -> dict[str, list[Any]]:
    """Returns the rows of every level that either protocol has, so that both have the same tabs."""
    levels = sorted({level for of in board["protocols"].values() for level in of})
    return {level: board["protocols"][name].get(level, []) for level in levels}


def _papers(reference: Mapping[str, Any], board: Mapping[str, Any], level: str) -> list[View]:
    """Returns the paper's rows at a level; a mean only where it has every task of the board."""
    if board["suite"] != "RoboVerse" or board["learned_from"] != "demonstrations":
        return []
    found: dict[str, dict[str, float]] = {}
    for row in reference["rows"]:
        if level in row["success_rate"]:
            found.setdefault(row["policy"], {})[row["task"]] = row["success_rate"][level]
    return [
        {
            "policy": policy,
            "cells": rates,
            "mean": sum(rates.values()) / len(rates) if set(rates) == set(board["tasks"]) else None,
        }
        for policy, rates in found.items()
    ]


def series_label(series: Mapping[str, Any], entries: Mapping[str, Any]) -> str:
    """Returns the name of a series in a legend: ``ACT, recipe act_v1``."""
    if series["entry"] is None:
        return str(series["label"])
    entry = entries[series["entry"]]
    moved = f", trained in {series['transferred_from']}" if series["transferred_from"] else ""
    same = [
        each
        for each in entries.values()
        if (entry_name(each), origin(each)) == (entry_name(entry), origin(entry))
    ]
    length = ""
    if len(same) > 1 and (entry["steps"] or entry["time_s"]):
        length = f", {entry['steps']:,} steps" if entry["steps"] else f", {entry['time_s']:.0f} s"
    return f"{entry_name(entry)}, {origin(entry)}{length}{moved}"


def _board_place(
    section: Mapping[str, Any], entries: Mapping[str, Any], reference: Mapping[str, Any]
) -> View:
    """Returns the entries of a section: a table and a chart for each protocol."""
    rows = section["rows"]
    protocols = []
    for name, series in standings(section).items():
        levels = sorted({level for each in series for level in each["cells"]})
        trained = {rows[index]["train_level"] for each in series for index in each["rows"]}
        if not series or (name == "B" and trained <= {0, None}):
            continue  # B would repeat what A says
        lines = series_lines(series, entries, lambda each: series_label(each, entries))
        protocols.append(
            {
                "name": name,
                "levels": levels,
                "alone": sorted({only for each in series for only in each["alone"]}),
                "series": [each | {"seeds": _seeds(each, rows)} for each in series],
                "chart": level_chart(lines),
            }
        )
    shown = [index for index, row in enumerate(rows) if row["kind"] != STUDY]
    papers = [row for row in reference["rows"] if row["task"] == section["task"]]
    bars = axis_bars(section, lambda row: series_label(row, entries))
    return _place(section, shown) | {"protocols": protocols, "papers": papers, "axes": axis_chart(bars)}


def _seeds(series: Mapping[str, Any], rows: Sequence[Mapping[str, Any]]) -> list[int]:
    return sorted({seed for index in series["rows"] for seed in rows[index]["seeds"]})


def _studies_place(section: Mapping[str, Any], board: Mapping[str, Any]) -> View:
    """Returns the studies of a section in one table, with the entries of the same policies."""
    policies = {row["policy"] for row in section["rows"] if row["kind"] == STUDY}
    shown = [index for index, row in enumerate(section["rows"]) if row["policy"] in policies]
    rows = [section["rows"][index] for index in shown]
    cells = [cell for row in rows for cell in row["cells"]]
    levels = sorted({cell["level"] for cell in cells if cell["level"] is not None})
    alone = sorted({cell["only"] for cell in cells if cell["only"] is not None})
    columns = [{"level": level, "only": None} for level in levels]
    columns += [{"level": None, "only": only} for only in alone]
    studies = [row for row in rows if row["kind"] == STUDY]
    return _place(section, shown, only_studies=True) | {
        "columns": columns,
        "grids": [[_find(row["cells"], column) for column in columns] for row in rows],
        "iqm": any(row["iqm_test"] for row in rows),
        "chart": level_chart([line(row["label"], row["cells"]) for row in studies]),
        "axes": axis_chart(axis_bars(section, lambda row: row["label"], studies=True)),
        "by_demonstrations": demonstrations_chart(section["by_demonstrations"]),
        "papers": [row for row in board["reference"]["rows"] if row["task"] == section["task"]],
    }


def _place(section: Mapping[str, Any], shown: Sequence[int], *, only_studies: bool = False) -> View:
    """Returns what both pages say of a section, for the rows of the given indices."""
    rows = [section["rows"][index] for index in shown]
    counted = [row for row in rows if row["kind"] == STUDY] if only_studies else rows
    labels = {row["label"] for row in counted}
    pairs: dict[tuple[str, str], list[Mapping[str, Any]]] = {}
    for test in section["comparisons"]:
        if {test["a"], test["b"]} <= labels:
            pairs.setdefault((test["a"], test["b"]), []).append(test)
    tested = [(test["level"], test["only"]) for tests in pairs.values() for test in tests]
    levels = sorted({level for level, _ in tested if level is not None})
    columns = [{"level": level, "only": None} for level in levels]
    columns += [{"level": None, "only": only} for only in sorted({only for _, only in tested if only})]
    curves = shown_curves(section, studies=only_studies)
    return {
        "section": section,
        "title": section["title"],
        "name": place_name(section),
        "kinds": {row["kind"] for row in rows},
        "rows": rows,
        "policies": sorted({row["policy"] for row in rows}),
        "num_rows": len(counted),
        "num_native": sum(row["transferred_from"] is None for row in counted),
        "pair_columns": columns,
        "pairs": [(*names, [_at(tests, column) for column in columns]) for names, tests in pairs.items()],
        "hidden": sorted({name for row in rows for cell in row["cells"] for name in cell["not_shown"]}),
        "learning": curve_charts(section["task"], curves, ends_when_solved=bool(section["ends_when_solved"])),
        "times": published_times(section["task"]) if curves else [],
        "watch": [row for row in counted if row["videos"]],
    }


def shown_curves(section: Mapping[str, Any], *, studies: bool) -> list[Mapping[str, Any]]:
    """Returns the learning curves of a page's rows, the first eight in the order of their recipes' names."""
    kinds = [row["kind"] for row in section["rows"]]
    own = [curve for curve in section["curves"] if (kinds[curve["row"]] == STUDY) == studies]
    first = sorted(own, key=lambda curve: (-len(curve["seeds"]), curve["label"]))[:MAX_LINES]
    return [curve for curve in own if curve in first]


def place_name(section: Mapping[str, Any]) -> str:
    """Returns the name of a simulator's tab: ``SAPIEN``, or ``MuJoCo, rendered with gl``."""
    drawn = (
        ""
        if section["renderer"] in ("warp", section["simulator"])
        else f", rendered with {section['renderer']}"
    )
    seed = f", seed {section['protocol_seed']}" if section["protocol_seed"] else ""
    return name_of(section["simulator"]) + drawn + seed


def _find(cells: Sequence[Mapping[str, Any]], column: Mapping[str, Any]) -> dict[str, Any]:
    """Returns a column's cell of either split, None where it was not evaluated."""
    return {
        split: _at([cell for cell in cells if cell["split"] == split], column) for split in ("test", "train")
    }


def _at(items: Sequence[Mapping[str, Any]], column: Mapping[str, Any]) -> Mapping[str, Any] | None:
    """Returns the item of a column's level or channel, None when there is none."""
    matching = (i for i in items if i["level"] == column["level"] and i["only"] == column["only"])
    return next(matching, None)
