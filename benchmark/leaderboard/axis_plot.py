"""The plot of success by what varies alone: groups of bars."""

from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import Any

from benchmark.leaderboard.axis_chart import groups_of
from benchmark.leaderboard.legend import legend_below
from benchmark.leaderboard.plots import COLORS, check_number, new_figure, save_figure


def plot_axes(
    bars: Sequence[Mapping[str, Any]],
    path: Path,
    title: str = "",
    *,
    drawn_of: str = "",
) -> None:
    """Draws success by what varies alone, on the test split with its 95 % interval.

    Args:
        bars: Policies, eight at most; see :func:`benchmark.leaderboard.axis_chart.axis_bars`.
        path: The ``.png`` (or ``.svg``) file.
        title: Title.
        drawn_of: As :func:`save_figure`.

    Raises:
        WriteError: The file cannot be written.
        ValueError: There are more policies than colours.
    """
    check_number(bars)
    figure, axes = new_figure((8.0, 3.4))
    groups = groups_of(bars)
    width = 0.78 / len(bars)
    for index, row in enumerate(bars):
        shown = [(place, row["cells"][axis]) for place, axis in enumerate(groups) if axis in row["cells"]]
        rates = [100 * cell["success_rate"] for _, cell in shown]
        below = [max(0.0, rate - 100 * cell["ci_low"]) for rate, (_, cell) in zip(rates, shown, strict=True)]
        above = [max(0.0, 100 * cell["ci_high"] - rate) for rate, (_, cell) in zip(rates, shown, strict=True)]
        axes.bar(
            [place + (index - (len(bars) - 1) / 2) * width for place, _ in shown],
            rates,
            0.92 * width,
            yerr=[below, above],
            color=COLORS[index],
            error_kw={"elinewidth": 0.9, "ecolor": "#404040"},
            label=row["label"],
        )
    axes.set(xticks=range(len(groups)), xticklabels=groups, ylim=(0, 103))
    axes.set_ylabel("success, %")
    axes.set_title(title or "Success by what varies alone", fontsize=11, loc="left")
    legend_below(figure, *axes.get_legend_handles_labels(), columns=1 if len(bars) > 3 else 2)
    save_figure(figure, path, drawn_of)
