"""The leaderboard: a pure function of the results files, so the same files give the same bytes.

A setting that a result lacks, because it is older than the setting, counts as today's default.

Rows share a section only when they are comparable: the same version and seed of the protocol, the
same task and criterion, simulator, renderer and horizon. Runs that differ in nothing but their training
seed are one row.
"""

import json
import re
from collections import Counter
from collections.abc import Mapping, Sequence
from dataclasses import asdict, dataclass, replace
from importlib.resources import files
from itertools import combinations
from pathlib import Path
from typing import Any

from benchmark.leaderboard.chains_section import chain_rows
from benchmark.leaderboard.curves_section import learning_curves
from benchmark.leaderboard.demonstrations_chart import demonstration_lines
from benchmark.leaderboard.entries import STUDY, BoardEntry, classify, is_foreign, one_row_each, shown_entries
from benchmark.leaderboard.headline import headline
from benchmark.leaderboard.instructions_table import instructions_table, without_instruction_tests
from benchmark.leaderboard.labels import options_of, settings_of
from benchmark.leaderboard.overview import overview
from benchmark.leaderboard.recipe_settings import completed
from benchmark.leaderboard.results_folder import (
    HTML_NAME,
    INSTRUCTIONS_HTML_NAME,
    INSTRUCTIONS_MARKDOWN_NAME,
    JSON_NAME,
    MARKDOWN_NAME,
    STUDIES_HTML_NAME,
    STUDIES_MARKDOWN_NAME,
    load_results,
)
from benchmark.leaderboard.rows import (
    Entry,
    build_row,
    group_runs,
    name_rows,
    rank,
    row_key,
)
from benchmark.leaderboard.suites_section import read_suites, suite_sections, without_section
from benchmark.protocol import Cell
from benchmark.records import EpisodeRecord, Result
from benchmark.statistics import compare, holm
from envs.core.atomic import write_file
from envs.core.fingerprint import canonical_json, digest

SCHEMA_VERSION = 2


def build(results_dir: Path, train: Mapping[str, Any] | None = None) -> dict[str, Any]:
    """Builds the leaderboard of a folder of results.

    Args:
        results_dir: Folder of ``<protocol>/<task>/<policy>/<run>.json``.
        train: Defaults of the training, for keys that a result is older than.

    Returns:
        Plain JSON values: ``schema_version``, ``latest`` (when the newest result was made), ``reference``,
        ``entries`` by id, ``headline`` (see :mod:`benchmark.leaderboard.headline`), ``overview`` (see
        :mod:`benchmark.leaderboard.overview`), ``suites`` (see
        :mod:`benchmark.leaderboard.suites_section`) and ``sections``, each with its ``rows``, lines
        ``by_demonstrations`` (see :mod:`benchmark.leaderboard.demonstrations_chart`), learning ``curves``,
        ``comparisons`` and ``notes``. A row's ``kind`` is ``entry``, ``baseline`` or ``study``.
        Where there are instruction tests, ``instructions`` has a row for each run that did some (see
        :mod:`benchmark.leaderboard.instructions_table`); where CALVIN's chains were run, ``chains`` has one
        for each policy (see :mod:`benchmark.leaderboard.chains_section`).

    Raises:
        ResultError: The folder is absent, or a file in it is not a valid result in its place; every
            such file is named.
    """
    whole = [
        (path, replace(result, config=completed(result.config, result.policy, train or {})))
        for path, result in load_results(results_dir)
    ]
    loaded = [(path, without_instruction_tests(result)) for path, result in whole]
    suites = read_suites(results_dir)
    in_suites = without_section(suites)
    results = [result for _, result in loaded]
    kinds = classify(results, train or {})
    kind_of = {path: kind for (path, _), kind in zip(loaded, kinds, strict=True)}
    groups: dict[tuple[str, ...], list[Entry]] = {}
    for path, result in loaded:
        if path in in_suites:
            continue
        groups.setdefault(_section_order(_section_key(result)), []).append((path, result))
    keys = sorted(groups)
    sections = [_rounded(_section(results_dir, groups[key], kind_of)) for key in keys]
    _name_apart(sections, keys)
    reference = json.loads(files("benchmark").joinpath("reference/paper.json").read_text())
    shown = {row["entry"] for section in sections for row in section["rows"]}
    entries = shown_entries(entry for _, entry in kinds if entry and entry.id in shown)
    instructed, chains = instructions_table(whole), chain_rows(results_dir)
    return {
        "schema_version": SCHEMA_VERSION,
        "latest": max((result.created for result in results), default=None),
        "reference": reference,
        "entries": entries,
        "headline": _rounded(headline(sections, entries, reference)),
        "overview": _rounded(overview(sections)),
        "suites": _rounded(suite_sections(suites, dict(loaded))),
        "sections": sections,
        **({"instructions": _rounded(instructed)} if instructed else {}),
        **({"chains": _rounded(chains)} if chains else {}),
    }


def write(results_dir: Path, train: Mapping[str, Any] | None = None) -> dict[str, Path]:
    """Writes the board, ``leaderboard.*``, the studies, ``studies.*``, and the plots.

    A plot whose content did not change is not rendered again. Plots of sections that the folder's last
    leaderboard had and this one has not are removed.

    Args:
        results_dir: The folder.
        train: As :func:`build`.

    Returns:
        What was written: ``json``, ``markdown``, ``html``, ``studies markdown``, ``studies html``, where
        there are instruction tests ``instructions markdown`` and ``instructions html``, and the plots,
        see :func:`benchmark.leaderboard.section_plots.section_plots`.

    Raises:
        ResultError: As :func:`build`; nothing is written then.
    """
    from benchmark.leaderboard import html
    from benchmark.leaderboard.section_plots import draw_sections, possible_plots

    board = build(results_dir, train)
    contents = {
        "json": (JSON_NAME, json.dumps(board, indent=1, allow_nan=False) + "\n"),
        "markdown": (MARKDOWN_NAME, html.render_markdown(board)),
        "html": (HTML_NAME, html.render_html(board)),
        "studies markdown": (STUDIES_MARKDOWN_NAME, html.render_studies_markdown(board)),
        "studies html": (STUDIES_HTML_NAME, html.render_studies_html(board)),
    }
    instructions = {
        "instructions markdown": (INSTRUCTIONS_MARKDOWN_NAME, html.render_instructions_markdown),
        "instructions html": (INSTRUCTIONS_HTML_NAME, html.render_instructions_html),
    }
    for kind, (name, render) in instructions.items():
        if "instructions" in board:
            contents[kind] = name, render(board)
        else:
            (results_dir / name).unlink(missing_ok=True)
    before = possible_plots(results_dir, results_dir / JSON_NAME)
    written: dict[str, Path] = {}
    for kind, (name, text) in contents.items():
        written[kind] = results_dir / name
        write_file(written[kind], text.encode())
    plots = draw_sections(results_dir, board)
    for path in before - set(plots.values()):
        path.unlink(missing_ok=True)
    return written | plots


def _section_key(result: Result) -> dict[str, Any]:
    """Returns what two results must share for their numbers to be compared."""
    tuning = {"simulator_settings": result.env.simulator_settings, "scenario": result.env.scenario}
    tuned: dict[str, Any] = {name: dict(values) for name, values in tuning.items() if values}
    if result.env.robot:
        tuned["robot"] = result.env.robot
    return {
        "protocol": result.protocol.version,
        "protocol_seed": result.protocol.seed,
        "task": result.env.task,
        "task_kwargs": dict(result.env.task_kwargs),
        "max_episode_steps": result.max_episode_steps,
        "control_hz": result.control_hz,
        "simulator": result.env.simulator,
        "renderer": result.env.renderer,
        **tuned,
    }


def _section_order(key: Mapping[str, Any]) -> tuple[str, ...]:
    """Returns the key that identifies and orders sections, those of a task together."""
    first = ("protocol", "task", "task_kwargs", "simulator", "renderer")
    return *(canonical_json(key[name]) for name in first), canonical_json(dict(key))


def _section(
    results_dir: Path, entries: list[Entry], kind_of: Mapping[str, tuple[str, BoardEntry | None]]
) -> dict[str, Any]:
    key = _section_key(entries[0][1])
    groups = group_runs(entries)
    rows = [build_row(results_dir, group) for group in groups]
    for row, ((path, first), *_) in zip(rows, groups, strict=True):
        kind, entry = kind_of[path]
        row |= {"kind": kind, "entry": entry.id if entry else None, "foreign": is_foreign(first)}
    one_row_each(rows)
    name_rows(rows, [row_key(group[0][1])["settings"] for group in groups])
    order = sorted(range(len(rows)), key=lambda index: rank(rows[index]))
    compared = [_Compared.of(group[0]) for group in groups]
    families: dict[bool, list[dict[str, Any]]] = {False: [], True: []}
    notes = []
    for first, second in combinations(order, 2):
        if _asks(rows[first]) != _asks(rows[second]):
            continue
        found, unlike = _compare(compared[first], compared[second])
        labels = {"a": rows[first]["label"], "b": rows[second]["label"]}
        families[rows[first]["kind"] == STUDY] += [labels | item for item in found]
        if unlike:
            notes.append(
                f"{unlike} test episodes of {labels['a']} and {labels['b']} begin differently, although they "
                "have the same index; they are left out of the paired comparison."
            )
    scene = key.get("scenario", {})
    env = entries[0][1].env
    kwargs, described = ", ".join(options_of(env)), ", ".join(settings_of(env))
    title = f"{key['task']}" + (f" ({described})" if described else "")
    name = "-".join([key["protocol"], key["task"], kwargs, key["simulator"], key["renderer"]])
    unusual = [f"seed{key['protocol_seed']}"] if key["protocol_seed"] else []
    unusual += [f"scenario-{digest(scene)}"] if scene else []  # it names files, and may be long
    return {
        "id": re.sub(r"[^A-Za-z0-9]+", "-", "-".join([name, *unusual])).strip("-").lower(),
        "title": title,
        **key,
        "ends_when_solved": _ends_when_solved(entries),
        "rows": [rows[index] for index in order],
        "by_demonstrations": demonstration_lines(groups, rows),
        "curves": learning_curves(results_dir, [groups[index] for index in order]),
        "comparisons": [test for family in families.values() for test in corrected(family)],
        "notes": notes,
    }


def corrected(comparisons: Sequence[Mapping[str, Any]]) -> list[dict[str, Any]]:
    """Returns paired comparisons with ``p_holm``, the p-value corrected for all that one table shows."""
    p_values = holm([test["p_value"] for test in comparisons])
    return [{**test, "p_holm": p} for test, p in zip(comparisons, p_values, strict=True)]


def _name_apart(sections: Sequence[dict[str, Any]], keys: Sequence[tuple[str, ...]]) -> None:
    """Makes the ids of sections unique, in place: they name plots, and places on a page.

    Sections of one id get their horizon, and those that have one id even so a digest of their key.
    """
    number = Counter(section["id"] for section in sections)
    for section in sections:
        if number[section["id"]] > 1:
            horizon = f"{section['max_episode_steps']}-steps-{section['control_hz']:g}-hz"
            section["id"] += "-" + horizon.replace(".", "-")
    number = Counter(section["id"] for section in sections)
    for section, key in zip(sections, keys, strict=True):
        if number[section["id"]] > 1:  # ids leave out what differs, such as the sign of -0.02
            section["id"] += "-" + digest(key)[:6]


def _asks(row: Mapping[str, Any]) -> tuple[Any, ...]:
    """Returns what the rows of a paired comparison share: both of the board or both studies, of one level."""
    return row["kind"] == STUDY, row["train_level"], row["train_only"]


def _ends_when_solved(entries: list[Entry]) -> bool | None:
    """Returns whether most solved episodes were over before their time; None where none was solved.

    Few are where the return decides success: there an episode may end late with enough reward.
    """
    early = [
        record.length < result.max_episode_steps
        for _, result in entries
        for record in result.records
        if record.success
    ]
    return 2 * sum(early) > len(early) if early else None


@dataclass(frozen=True, slots=True)
class _Compared:
    """A run and its test episodes, by cell and index."""

    path: str
    cells: dict[Cell, dict[int, EpisodeRecord]]

    @classmethod
    def of(cls, entry: Entry) -> "_Compared":
        path, result = entry
        tested = [cell for cell in result.protocol.cells() if cell.split == "test"]
        cells: dict[Cell, dict[int, EpisodeRecord]] = {cell: {} for cell in tested}
        for record in result.records:
            if record.split == "test":
                cells[record.cell][record.episode] = record
        return cls(path, cells)


def _compare(a: _Compared, b: _Compared) -> tuple[list[dict[str, Any]], int]:
    """Compares two runs on the episodes they share, cell by cell of the test split.

    Returns:
        One comparison per cell, and the number of episodes that have the same index and begin
        differently.
    """
    found, unlike = [], 0
    for cell, first in a.cells.items():
        second = b.cells.get(cell, {})
        shared = [episode for episode in first if episode in second]
        same = [e for e in shared if first[e].initial_state_hash == second[e].initial_state_hash]
        unlike += len(shared) - len(same)
        if same:
            test = compare([first[e].success for e in same], [second[e].success for e in same])
            runs = {"run_a": a.path, "run_b": b.path, "level": cell.level, "only": cell.only}
            found.append(runs | asdict(test))
    return found, unlike


def _rounded(values: Any) -> Any:
    """Rounds to 6 decimals: another release of scipy may differ in the last bit."""
    if isinstance(values, float):
        return round(values, 6)
    if isinstance(values, dict):
        return {key: _rounded(value) for key, value in values.items()}
    if isinstance(values, list):
        return [_rounded(value) for value in values]
    return values
