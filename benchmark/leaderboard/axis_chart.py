"""Success by what varies alone, as groups of bars: one group for each axis, one bar for each policy.

The first group is level 0, the same episodes where nothing else varies: the loss to it is an axis's cost.
"""

from collections.abc import Callable, Mapping, Sequence
from typing import Any

from benchmark.leaderboard.entries import STUDY
from benchmark.leaderboard.level_chart import MAX_LINES
from benchmark.leaderboard.plots import COLORS

NOTHING = "level 0"
"""The group of what was tested at level 0, beside the axes."""

AXES = ("robot", "language", "sensor", "layout", "environment", "camera", "lighting")
"""Order of the groups; other channels, and lists of them, come after these by name."""

_WIDTH, _HEIGHT = 720, 250
_LEFT, _RIGHT, _TOP, _BOTTOM = 44, 8, 14, 28
_GROUP_SHARE = 0.78
"""Share of a group's width that its bars fill."""

type Bars = dict[str, Any]


def axis_bars(
    section: Mapping[str, Any], label_of: Callable[[Mapping[str, Any]], str], *, studies: bool = False
) -> list[Bars]:
    """Returns what each policy of a section reached on its axes; none where nothing varied alone.

    Args:
        section: One of :func:`benchmark.leaderboard.build.build`.
        label_of: Names a row of it.
        studies: Whether its studies are meant; if not, its entries and baselines.

    Returns:
        One for each method that was tested with something that varied alone, the eight with
        most axes and test episodes: its ``label``, ``policy``, and ``cells``, of axis to cell of the test
        split. Rows of one entry that were trained alike are one method: its levels and its axes may come from
        two evaluations.
    """
    found: dict[tuple[Any, ...], Bars] = {}
    for index, row in enumerate(section["rows"]):
        tested = {axis: cell for cell in row["cells"] if cell["split"] == "test" and (axis := _axis(cell))}
        if (row["kind"] == STUDY) != studies or not tested:
            continue
        method = (row["entry"] or index, row["transferred_from"], row["train_level"], row["train_only"])
        trained = _trained(row)
        label = label_of(row) + (f", trained {trained}" if trained and not studies else "")
        own = found.setdefault(method, {"label": label, "policy": row["policy"], "cells": {}})
        own["cells"] = tested | own["cells"]
    bars = [each for each in found.values() if set(each["cells"]) - {NOTHING}]
    order = sorted(range(len(bars)), key=lambda i: (-len(bars[i]["cells"]), -_episodes(bars[i]), i))
    return [bars[index] for index in sorted(order[:MAX_LINES])]


def groups_of(bars: Sequence[Mapping[str, Any]]) -> list[str]:
    """Returns the axes of several policies in the order in which they are drawn."""
    order = {name: index for index, name in enumerate((NOTHING, *AXES))}
    return sorted(
        {axis for each in bars for axis in each["cells"]}, key=lambda a: (order.get(a, len(order)), a)
    )


def axis_chart(bars: Sequence[Bars]) -> dict[str, Any] | None:
    """Returns the coordinates of a chart in SVG, or None where there are no bars."""
    if not bars:
        return None
    groups = groups_of(bars)
    inner = _WIDTH - _LEFT - _RIGHT
    width = _GROUP_SHARE * inner / len(groups) / len(bars)

    def y(rate: float) -> float:
        return round(_TOP + (1 - rate) * (_HEIGHT - _TOP - _BOTTOM), 1)

    def middle(group: int) -> float:
        return _LEFT + (group + 0.5) * inner / len(groups)

    drawn = []
    for index, each in enumerate(bars):
        own = []
        for group, axis in enumerate(groups):
            if axis in each["cells"]:
                cell = each["cells"][axis]
                x = middle(group) + (index - len(bars) / 2) * width
                place = {"x": round(x, 1), "y": y(cell["success_rate"]), "middle": round(x + width / 2, 1)}
                own.append(
                    place | {"low": y(cell["ci_low"]), "high": y(cell["ci_high"]), "axis": axis, "cell": cell}
                )
        drawn.append({"label": each["label"], "policy": each["policy"], "color": COLORS[index], "bars": own})
    return {
        "width": _WIDTH,
        "height": _HEIGHT,
        "left": _LEFT,
        "right": _WIDTH - _RIGHT,
        "bottom": _HEIGHT - _BOTTOM,
        "bar": round(0.92 * width, 1),
        "ticks": [{"y": y(rate / 100), "text": f"{rate} %"} for rate in (0, 25, 50, 75, 100)],
        "groups": [{"axis": axis, "x": round(middle(group), 1)} for group, axis in enumerate(groups)],
        "series": drawn,
    }


def _axis(cell: Mapping[str, Any]) -> str | None:
    return cell["only"] or (NOTHING if cell["level"] == 0 else None)


def _trained(row: Mapping[str, Any]) -> str:
    """Returns where a row was trained, if not at level 0: only then is it said."""
    if row["train_only"]:
        return f"on {row['train_only']} alone"
    return f"at level {row['train_level']}" if row["train_level"] else ""


def _episodes(bars: Bars) -> int:
    return sum(cell["episodes"] for cell in bars["cells"].values())
