"""Plots of results: success over the levels, and the losses of a training run."""

from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import Any

from benchmark.leaderboard.legend import legend_below
from benchmark.leaderboard.plot_cache import KEYWORD
from envs.core.atomic import atomic_path

COLORS = ("#0072b2", "#d55e00", "#009e73", "#cc79a7", "#e69f00", "#56b4e9", "#7f7f7f", "#000000")
"""Okabe & Ito's palette, which stays apart for colour-blind readers."""

LESS_WHEN_SOLVED = "it ends when solved, with less reward"
"""Why returns fall while success rises, where a solved episode is over."""

_DPI = 160

_MARKERS = "osD^v*XP"


def plot_levels(
    rows: Sequence[Mapping[str, Any]], path: Path, title: str = "", *, drawn_of: str = ""
) -> None:
    """Draws success over the levels: the test split solid with its 95 % interval, the train split dashed.

    Args:
        rows: The lines, eight at most, each with ``label`` and ``cells``; see
            :func:`benchmark.leaderboard.level_chart.chosen_lines`.
        path: The ``.png`` (or ``.svg``) file.
        title: Title.
        drawn_of: As :func:`save_figure`.

    Raises:
        WriteError: The file cannot be written.
        ValueError: There are more lines than colours.
    """
    check_number(rows)
    figure, axes = new_figure((6.0, 3.4))
    shift = min(
        0.06, 0.4 / max(1, len(rows))
    )  # levels are whole numbers: intervals of several policies would hide each other
    for index, row in enumerate(rows):
        color, marker = COLORS[index], _MARKERS[index]
        offset = shift * (index - (len(rows) - 1) / 2)
        for split, style in (("test", "-"), ("train", "--")):
            cells = [cell for cell in row["cells"] if cell["split"] == split and cell["level"] is not None]
            if not cells:
                continue
            x = [cell["level"] + offset for cell in cells]
            rates = [100 * cell["success_rate"] for cell in cells]
            below = [rate - 100 * cell["ci_low"] for rate, cell in zip(rates, cells, strict=True)]
            above = [100 * cell["ci_high"] - rate for rate, cell in zip(rates, cells, strict=True)]
            test = split == "test"
            # Rounding can leave an end of an interval 1e-15 on the wrong side of its rate.
            bars = [[max(0.0, length) for length in side] for side in (below, above)]
            axes.errorbar(
                x,
                rates,
                yerr=bars if test else None,
                linestyle=style,
                color=color,
                marker=marker if test else None,
                markersize=4,
                linewidth=1.8 if test else 1.1,
                capsize=3,
                alpha=1.0 if test else 0.6,
                label=row["label"] if test else None,
            )
    levels = sorted({cell["level"] for row in rows for cell in row["cells"] if cell["level"] is not None})
    axes.set(xticks=levels, xticklabels=[f"level {level}" for level in levels], ylim=(-3, 103))
    axes.set_ylabel("success, %")
    axes.set_title(title or "Success over generalization levels", fontsize=11, loc="left")
    splits = {cell["split"] for row in rows for cell in row["cells"] if cell["level"] is not None}
    if "train" in splits:
        axes.plot([], [], linestyle="--", color="#7f7f7f", linewidth=1.1, label="same, train split")
    legend_below(figure, *axes.get_legend_handles_labels(), columns=1 if len(rows) > 3 else 2)
    save_figure(figure, path, drawn_of)


def check_number(lines: Sequence[Any]) -> None:
    """Checks that every line of a plot has a colour of its own.

    Raises:
        ValueError: There are more than eight.
    """
    if len(lines) > len(COLORS):
        raise ValueError(f"A plot has at most {len(COLORS)} lines, given {len(lines)}.")


def plot_losses(rows: Sequence[Mapping[str, float]], path: Path, title: str = "Training") -> None:
    """Draws every loss of a training run over its steps, raw and smoothed.

    Args:
        rows: One mapping per logged step: ``step`` and the losses, by name; other keys that do not
            contain ``loss`` are left out. A row may lack a loss.
        path: The ``.png`` (or ``.svg``) file.
        title: Title.

    Raises:
        WriteError: The file cannot be written.
        ValueError: No row holds a loss.
    """
    names = list(dict.fromkeys(name for row in rows for name in row if "loss" in name))
    if not names:
        raise ValueError("There is no loss to plot: no row has a key with 'loss' in its name.")
    figure, axes = new_figure((6.0, 3.4))
    lowest = float("inf")
    for index, name in enumerate(names):
        points = [(float(row["step"]), float(row[name])) for row in rows if name in row]
        steps, values = zip(*points, strict=True)
        color = COLORS[index % len(COLORS)]
        axes.plot(steps, values, color=color, alpha=0.25, linewidth=0.8)
        axes.plot(steps, _smooth(values), color=color, linewidth=1.8, label=name)
        lowest = min(lowest, *values)
    if lowest > 0:
        axes.set_yscale("log")
    axes.set(xlabel="training step", ylabel="loss")
    axes.set_title(title, fontsize=11, loc="left")
    axes.legend(frameon=False, fontsize=8)
    save_figure(figure, path)


def plot_learning(
    curves: Sequence[Mapping[str, Any]],
    path: Path,
    title: str = "",
    others: Sequence[Mapping[str, Any]] = (),
    *,
    ends_when_solved: bool = False,
    drawn_of: str = "",
) -> None:
    """Draws return and success over environment steps: interquartile mean over seeds, and its 95 % interval.

    Args:
        curves: Eight at most of those of one section of the leaderboard, from
            :func:`benchmark.leaderboard.curves_section.learning_curves`.
        path: The ``.png`` (or ``.svg``) file.
        title: Title.
        others: What others published of the task, from :func:`benchmark.learning_curves.published`.
        ends_when_solved: Whether a solved episode is over; the plot then says why the return falls.
        drawn_of: As :func:`save_figure`.

    Raises:
        WriteError: The file cannot be written.
        ValueError: There are more curves than colours.
    """
    from matplotlib.ticker import EngFormatter

    check_number(curves)
    figure, both = new_figure((9.0, 3.3), columns=2)
    labels = {
        "episode_return": "return of an episode" + f"\n({LESS_WHEN_SOLVED})" * ends_when_solved,
        "success_rate": "success in training",
    }
    for axes, (name, label) in zip(both, labels.items(), strict=True):
        for curve, color in zip(curves, COLORS, strict=False):
            steps, measure = curve["steps"], curve[name]
            legend = f"{curve['label']}, {seeds_and_time(curve)}"
            axes.plot(steps, measure["mid"], color=color, linewidth=1.8, label=legend)
            if measure["low"] is not None:
                axes.fill_between(steps, measure["low"], measure["high"], color=color, alpha=0.2, linewidth=0)
        axes.set(xlabel="environment steps", ylabel=label)
        axes.locator_params(axis="x", nbins=5)
        axes.xaxis.set_major_formatter(EngFormatter(sep=""))
    for other, marker in zip(others, "*Xdsv^", strict=False):
        name = f"{other['method']}, published"
        both[0].plot([other["steps"]], [other["episode_return"]], marker, color="#7f7f7f", label=name)
    both[1].set_ylim(-0.03, 1.03)
    both[0].set_title(title, fontsize=11, loc="left")
    legend_below(figure, *both[0].get_legend_handles_labels())  # the upper left may hold results
    save_figure(figure, path, drawn_of)


def seeds_and_time(curve: Mapping[str, Any]) -> str:
    """Returns the seeds and the time of a learning curve as text: ``2 seeds, 9.3 min``."""
    number, seconds = len(curve["seeds"]), curve["seconds"][-1]
    took = f"{seconds:.0f} s" if seconds < 60 else f"{seconds / 60:.3g} min"
    return f"{number} seed{'s' * (number > 1)}, {took}"


def _smooth(values: Sequence[float]) -> list[float]:
    """Exponential moving average over about a thirtieth of the run, without the start's bias."""
    weight = 1.0 - 1.0 / max(1.0, len(values) / 30.0)
    mean, total, smoothed = 0.0, 0.0, []
    for value in values:
        mean = weight * mean + value
        total = weight * total + 1.0
        smoothed.append(mean / total)
    return smoothed


def new_figure(size: tuple[float, float], columns: int = 1) -> tuple[Any, Any]:
    """Returns a figure that needs no display and leaves matplotlib's global state alone.

    Args:
        size: Width and height, inches.
        columns: Axes side by side.

    Returns:
        The figure, and its axes: one, or an array of several.
    """
    from matplotlib.backends.backend_agg import FigureCanvasAgg
    from matplotlib.figure import Figure

    figure = Figure(figsize=size, dpi=_DPI, layout="constrained")
    FigureCanvasAgg(figure)
    axes = figure.subplots(1, columns, squeeze=False)[0]
    for each in axes:
        each.spines[["top", "right"]].set_visible(False)
        each.grid(axis="y", alpha=0.3, linewidth=0.6)
    return figure, axes if columns > 1 else axes[0]


def save_figure(figure: Any, path: Path, drawn_of: str = "") -> None:
    """Writes a figure as ``.png`` or ``.svg``, atomically.

    Args:
        figure: The figure.
        path: The file.
        drawn_of: Hash for the metadata of a ``.png``; see :mod:`benchmark.leaderboard.plot_cache`.

    Raises:
        WriteError: The file cannot be written.
    """
    with atomic_path(path, keep_suffix=True) as temporary:
        # Matplotlib writes its version into a PNG: the same rows must give the same bytes everywhere.
        keyword = {KEYWORD: drawn_of} if drawn_of else {}
        metadata = {"Software": None} | keyword if path.suffix == ".png" else None
        figure.savefig(temporary, dpi=_DPI, metadata=metadata)
