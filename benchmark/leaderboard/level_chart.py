"""Success over the levels as lines, at most eight of them in a plot, and their SVG coordinates."""

from collections.abc import Iterable, Mapping, Sequence
from typing import Any

from benchmark.leaderboard.plots import COLORS

MAX_LINES = 8

_WIDTH, _HEIGHT = 560, 280
_LEFT, _RIGHT, _TOP, _BOTTOM = 44, 16, 14, 40

type Line = dict[str, Any]


def line(label: str, cells: Iterable[Mapping[str, Any]], *, first: bool = False) -> Line:
    """Returns a line of a plot: its ``label``, its ``cells`` of levels, and whether it comes ``first``."""
    return {"label": label, "cells": [cell for cell in cells if cell["level"] is not None], "first": first}


def series_lines(
    series: Sequence[Mapping[str, Any]], entries: Mapping[str, Mapping[str, Any]], label_of: Any
) -> list[Line]:
    """Returns the lines of one protocol's series, those of recipes first in choice."""
    return [
        line(
            label_of(each),
            [cell for of_level in each["cells"].values() for cell in of_level.values()],
            first=each["entry"] is not None and entries[each["entry"]]["kind"] == "recipe",
        )
        for each in series
    ]


def chosen_lines(lines: Sequence[Line]) -> list[Line]:
    """Returns the lines that a plot shows, in their order; none where no line joins two levels.

    Recipes come first, then what was tested at most levels and in most episodes; never what did best. The
    train split is drawn where the plot has room for it: it counts as a line, too.
    """
    if not any(len(_of(each, "test")) > 1 for each in lines):
        return []
    order = sorted(range(len(lines)), key=lambda index: _weight(lines[index]))
    chosen = [lines[index] for index in sorted(order[:MAX_LINES])]
    number = len(chosen) + sum(bool(_of(each, "train")) for each in chosen)
    splits = ("test", "train") if number <= MAX_LINES else ("test",)
    return [
        {"label": each["label"], "cells": [cell for split in splits for cell in _of(each, split)]}
        for each in chosen
    ]


def level_chart(lines: Sequence[Line]) -> dict[str, Any] | None:
    """Returns the coordinates of a plot, or None when there is nothing to join.

    Args:
        lines: All lines; :func:`chosen_lines` takes those that are shown.
    """
    shown = chosen_lines(lines)
    if not shown:
        return None
    levels = sorted({cell["level"] for each in shown for cell in each["cells"]})
    step = min(10.0, 80.0 / max(1, len(shown) - 1))  # else the intervals of several lines hide each other
    spread = step * (len(shown) - 1)

    def x(level: int, index: int) -> float:
        inner = _WIDTH - _LEFT - _RIGHT - spread - 60
        shift = step * index - spread / 2
        return round(_LEFT + 30 + spread / 2 + inner * levels.index(level) / (len(levels) - 1) + shift, 1)

    def y(rate: float) -> float:
        return round(_TOP + (1 - rate) * (_HEIGHT - _TOP - _BOTTOM), 1)

    curves = []
    for index, each in enumerate(shown):
        points: dict[str, list[dict[str, float]]] = {"test": [], "train": []}
        for cell in each["cells"]:
            ends = {"low": y(cell["ci_low"]), "high": y(cell["ci_high"])}
            at = {"x": x(cell["level"], index), "y": y(cell["success_rate"])}
            points[cell["split"]].append(at | ends)
        curves.append({"label": each["label"], "color": COLORS[index], **points})
    return {
        "width": _WIDTH,
        "height": _HEIGHT,
        "left": _LEFT,
        "right": _WIDTH - _RIGHT,
        "bottom": _HEIGHT - _BOTTOM,
        "ticks": [{"y": y(rate / 100), "text": f"{rate} %"} for rate in (0, 25, 50, 75, 100)],
        "levels": [{"level": level, "x": round(x(level, 0) + spread / 2, 1)} for level in levels],
        "curves": curves,
        "left_out": len(lines) - len(shown),
    }


def _of(each: Line, split: str) -> list[Mapping[str, Any]]:
    return sorted((cell for cell in each["cells"] if cell["split"] == split), key=lambda cell: cell["level"])


def _weight(each: Line) -> tuple[Any, ...]:
    tested = _of(each, "test")
    return not each["first"], -len(tested), -sum(cell["episodes"] for cell in tested), each["label"]
