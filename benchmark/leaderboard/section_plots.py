"""The images of ``plots/``: success over the levels and learning curves of each section."""

import json
from collections.abc import Callable, Collection, Iterator, Mapping
from dataclasses import dataclass
from pathlib import Path
from typing import Any

from benchmark.leaderboard.axis_chart import axis_bars
from benchmark.leaderboard.axis_plot import plot_axes
from benchmark.leaderboard.demonstrations_chart import plot_demonstrations
from benchmark.leaderboard.entries import STUDY
from benchmark.leaderboard.level_chart import chosen_lines, line, series_lines
from benchmark.leaderboard.plot_cache import draw_if_changed
from benchmark.leaderboard.plots import plot_learning, plot_levels
from benchmark.leaderboard.results_folder import PLOTS
from benchmark.leaderboard.standings import standings
from benchmark.leaderboard.views import series_label, shown_curves
from benchmark.learning_curves import published

_SUFFIXES = (
    "",
    "-b",
    "-studies",
    "-axes",
    "-studies-axes",
    "-learning",
    "-studies-learning",
    "-studies-demos",
)


@dataclass(frozen=True, slots=True)
class SectionPlot:
    """One image: its ``kind`` and ``name``, and the function and values that draw it."""

    kind: str
    name: str
    draw: Callable[..., None]
    values: Any
    more: tuple[Any, ...]
    options: Mapping[str, Any]


def draw_sections(results_dir: Path, board: Mapping[str, Any]) -> dict[str, Path]:
    """Draws what changed of the plots of a board; returns all of them.

    Returns:
        Paths by kind: ``plot <section>`` and ``plot <section>-b`` of the entries by the protocols A and B,
        ``plot <section>-studies``, ``plot <section>-axes`` of what varied alone (and
        ``-studies-axes``), ``plot <section>-studies-demos`` of numbers of demonstrations, and
        ``learning <section>`` and ``learning <section>-studies``.
    """
    plots = {}
    for section in board["sections"]:
        for plot in section_plots(section, board["entries"]):
            path = plots[plot.kind] = results_dir / PLOTS / f"{plot.name}.png"
            draw_if_changed(plot.draw, plot.values, path, *plot.more, **plot.options)
    return plots


def section_plots(section: Mapping[str, Any], entries: Mapping[str, Any]) -> Iterator[SectionPlot]:
    """Yields the plots of a section that have something to join."""
    name, title = section["id"], section["title"]
    lines = {
        protocol: series_lines(series, entries, lambda each: series_label(each, entries))
        for protocol, series in standings(section).items()
    }
    studies = [line(row["label"], row["cells"]) for row in section["rows"] if row["kind"] == STUDY]
    trained = {row["train_level"] for row in section["rows"] if row["kind"] != STUDY}
    of_levels = [("", title, lines["A"]), ("-studies", f"{title}, studies", studies)]
    if trained - {0, None}:
        of_levels.append(("-b", f"{title}, trained at the tested level", lines["B"]))
    for suffix, head, all_lines in of_levels:
        if shown := chosen_lines(all_lines):
            yield SectionPlot(f"plot {name}{suffix}", name + suffix, plot_levels, shown, (head,), {})
    labels = {"": lambda row: series_label(row, entries), "-studies": lambda row: row["label"]}
    for suffix, label_of in labels.items():
        if bars := axis_bars(section, label_of, studies=bool(suffix)):
            head = f"{title}, by what varies alone" + (", studies" if suffix else "")
            yield SectionPlot(
                f"plot {name}{suffix}-axes", f"{name}{suffix}-axes", plot_axes, bars, (head,), {}
            )
    if lines := section["by_demonstrations"]:
        head = f"{title}, by number of demonstrations"
        yield SectionPlot(
            f"plot {name}-studies-demos", f"{name}-studies-demos", plot_demonstrations, lines, (head,), {}
        )
    for suffix in ("", "-studies"):
        if curves := shown_curves(section, studies=bool(suffix)):
            more = (title, published(section["task"]))
            options = {"ends_when_solved": bool(section["ends_when_solved"])}
            kind = f"learning {name}{suffix}"
            yield SectionPlot(kind, f"{name}{suffix}-learning", plot_learning, curves, more, options)


def possible_plots(results_dir: Path, board: Path, of: Collection[str] | None = None) -> set[Path]:
    """Returns the plots that a leaderboard's file may have; none if it cannot be read.

    Args:
        results_dir: Folder of results.
        board: The leaderboard's JSON file.
        of: Paths of results, relative to the folder: only the plots of their sections.
    """
    try:
        sections = json.loads(board.read_text(encoding="utf-8"))["sections"]
        names = [section["id"] for section in sections if of is None or _paths_in(section) & {*of}]
        folder = results_dir / PLOTS
        return {folder / f"{name}{suffix}.png" for name in names for suffix in _SUFFIXES}
    except (OSError, ValueError, TypeError, LookupError):  # there is none, or it is damaged, or another's
        return set()


def _paths_in(section: Mapping[str, Any]) -> set[str]:
    return {run["path"] for row in section["rows"] for run in row["runs"]}
