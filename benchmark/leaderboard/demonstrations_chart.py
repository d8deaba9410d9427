"""Success over the number of demonstrations: a line for each policy and kind of demonstrations.

Lines differ in nothing but the number: the same policy, settings, steps and images. So two lines compare
what demonstrations of two sources are worth, as those of an expert and those made from a few of them.
"""

import math
from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import Any

from benchmark.leaderboard.curve_chart import thousands
from benchmark.leaderboard.legend import legend_below
from benchmark.leaderboard.plots import COLORS, new_figure, save_figure
from benchmark.leaderboard.rows import Entry, name_rows, policy_label, row_key
from envs.core.fingerprint import canonical_json

type Line = dict[str, Any]

_SHARED_NOT = ("demonstrations", "protocol_hash", "tested_alone")
"""Fields in which the runs of a line may differ."""

_WIDTH, _HEIGHT = 560, 260
_LEFT, _RIGHT, _TOP, _BOTTOM = 60, 20, 16, 40


def demonstration_lines(groups: Sequence[Sequence[Entry]], rows: Sequence[Mapping[str, Any]]) -> list[Line]:
    """Returns the lines of a section, each with two numbers of demonstrations or more.

    Args:
        groups: The runs of every row.
        rows: The rows, in the same order; see :func:`benchmark.leaderboard.rows.build_row`.

    Returns:
        Of each line its ``label``, the ``level`` of training and test, and its ``points`` in the order of
        ``demonstrations``, with ``success_rate``, ``ci_low``, ``ci_high`` and ``episodes``.
    """
    found: dict[str, tuple[dict[str, Any], dict[int, Mapping[str, Any]]]] = {}
    for group, row in zip(groups, rows, strict=True):
        cell = _tested_where_trained(row)
        if cell is None or not row["demonstrations"] or row["transferred_from"]:
            continue
        key = {name: value for name, value in row_key(group[0][1]).items() if name not in _SHARED_NOT}
        label = policy_label(group[0][1])
        _, points = found.setdefault(canonical_json(key), (key | {"label": label, "runs": row["runs"]}, {}))
        before = points.get(row["demonstrations"])
        if before is None or before["episodes"] < cell["episodes"]:
            points[row["demonstrations"]] = cell
    several = [(key, points) for key, points in found.values() if len(points) > 1]
    named = [key for key, _ in several]
    name_rows(named, [key["settings"] for key in named])
    lines = [
        {
            "label": key["label"],
            "level": key["train_level"],
            "points": [{"demonstrations": number} | _rates(points[number]) for number in sorted(points)],
        }
        for key, points in several
    ]
    return sorted(lines, key=lambda line: (line["level"], line["label"]))


def demonstrations_chart(lines: Sequence[Line]) -> dict[str, Any] | None:
    """Returns the coordinates of a plot of the first eight lines, or None without any."""
    shown = lines[: len(COLORS)]
    if not shown:
        return None
    numbers = sorted({point["demonstrations"] for line in shown for point in line["points"]})
    first, last = math.log(numbers[0]), math.log(numbers[-1])

    def x(number: int) -> float:
        return round(_LEFT + (math.log(number) - first) / (last - first) * (_WIDTH - _LEFT - _RIGHT), 1)

    def y(rate: float) -> float:
        return round(_TOP + (1.0 - rate) * (_HEIGHT - _TOP - _BOTTOM), 1)

    curves = []
    for line, color in zip(shown, COLORS, strict=False):
        there = [(x(point["demonstrations"]), y(point["ci_high"])) for point in line["points"]]
        back = [(x(point["demonstrations"]), y(point["ci_low"])) for point in line["points"]]
        middle = [(x(point["demonstrations"]), y(point["success_rate"])) for point in line["points"]]
        curves.append({"label": line["label"], "color": color, "line": middle, "band": there + back[::-1]})
    return {
        "title": "success by number of demonstrations",
        "width": _WIDTH,
        "height": _HEIGHT,
        "left": _LEFT,
        "right": _WIDTH - _RIGHT,
        "bottom": _HEIGHT - _BOTTOM,
        "ticks": [{"y": y(rate / 100), "text": f"{rate} %"} for rate in (0, 25, 50, 75, 100)],
        "steps": [{"x": x(number), "text": thousands(number)} for number in numbers],
        "lines": curves,
        "others": [],
    }


def plot_demonstrations(lines: Sequence[Line], path: Path, title: str = "", *, drawn_of: str = "") -> None:
    """Draws success, with its 95 % interval, over the number of demonstrations, the first eight lines.

    Args:
        lines: From :func:`demonstration_lines`.
        path: The ``.png`` (or ``.svg``) file.
        title: Title.
        drawn_of: As :func:`benchmark.leaderboard.plots.save_figure`.

    Raises:
        WriteError: The file cannot be written.
    """
    figure, axes = new_figure((6.0, 3.4))
    for line, color in zip(lines, COLORS, strict=False):
        numbers = [point["demonstrations"] for point in line["points"]]
        rates, lows, highs = (
            [100 * point[name] for point in line["points"]] for name in ("success_rate", "ci_low", "ci_high")
        )
        axes.plot(numbers, rates, "o-", color=color, markersize=4, linewidth=1.8, label=line["label"])
        axes.fill_between(numbers, lows, highs, color=color, alpha=0.15, linewidth=0)
    ticks = sorted({point["demonstrations"] for line in lines for point in line["points"]})
    axes.set_xscale("log")
    axes.set_xticks(ticks, [thousands(number) for number in ticks])
    axes.minorticks_off()
    axes.set(xlabel="demonstrations", ylabel="success, %", ylim=(-3, 103))
    axes.set_title(title, fontsize=11, loc="left")
    legend_below(figure, *axes.get_legend_handles_labels(), columns=1)
    save_figure(figure, path, drawn_of)


def _tested_where_trained(row: Mapping[str, Any]) -> Mapping[str, Any] | None:
    """Returns the cell of the test split at the level of the training, None where there is none."""
    level = row["train_level"]
    found = (cell for cell in row["cells"] if cell["split"] == "test" and cell["level"] == level)
    return None if level is None else next(found, None)


def _rates(cell: Mapping[str, Any]) -> dict[str, Any]:
    return {name: cell[name] for name in ("success_rate", "ci_low", "ci_high", "episodes")}
