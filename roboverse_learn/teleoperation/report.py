"""What a run of teleoperation prints at its end."""

from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import TYPE_CHECKING, Any

from rich.console import Group
from rich.table import Table

from envs.vector_env import RoboVerseVectorEnv
from roboverse_learn.checks.contract import counted
from roboverse_learn.commands.report import unbroken
from roboverse_learn.teleoperation.quality import Quality, mean, measure
from roboverse_learn.teleoperation.recording import Mark

if TYPE_CHECKING:
    from roboverse_learn.data.collection.collect import CollectionSummary
    from roboverse_learn.teleoperation.conductor import Figures

MAX_ROWS = 30
"""Episodes that are printed, the newest."""

MAX_COMPARED = 20
"""Episodes that the expert runs for comparison."""


def expert_quality(env: RoboVerseVectorEnv, rows: Sequence[Mapping[str, Any]]) -> Quality | None:
    """Returns the mean figures of the task's expert in episodes of which there is a success.

    Args:
        env: The environments.
        rows: Facts of recordings.

    Returns:
        None if the task has no expert, or there is no success.
    """
    from envs.experts.actor import expert_episodes

    chosen = [int(row["episode"]) for row in rows if row["mark"] == Mark.SUCCESS][:MAX_COMPARED]
    if not env.task.has_expert or not chosen:
        return None
    robot = env.scenario.robots[0]
    runs = expert_episodes(env, chosen, record=("states",))
    return mean([measure(run.raw, robot, float(env.control_hz)) for run in runs if run.success])


def episodes_table(rows: Sequence[Mapping[str, Any]], expert: Quality | None) -> Table:
    """Returns the newest episodes, the mean of the successes, and the expert's in the same episodes."""
    counts = {mark: sum(row["mark"] == mark for row in rows) for mark in Mark}
    title = ", ".join(f"{number} {mark}" for mark, number in counts.items())
    table = Table(title=f"Episodes: {title}", title_justify="left")
    for name in ("recording", "episode", "mark", "operator", "device"):
        table.add_column(name)
    for name in ("seconds", "path m", "idle %"):
        table.add_column(name, justify="right")
    for row in rows[-MAX_ROWS:]:
        named = [str(row[key]) for key in ("index", "episode", "mark", "operator", "device")]
        table.add_row(*named, *_figures(_quality(row)))
    table.add_section()
    own = mean([_quality(row) for row in rows if row["mark"] == Mark.SUCCESS])
    for name, figures in (("mean of successes", own), ("expert, same episodes", expert)):
        if figures is not None:
            table.add_row(name, "", "", "", "", *_figures(figures))
    return table


def teleoperation_report(
    table: Table, folder: Path, dataset: "CollectionSummary | None", figures: "Figures | None", again: str
) -> Group:
    """Returns the table, how time was kept, and where everything is.

    Args:
        table: See :func:`episodes_table`.
        folder: The recordings.
        dataset: What was rendered of them; None where nothing was.
        figures: How time was kept; None without a page.
        again: The command that renders them again; empty where there is no success to render.
    """
    lines = []
    if figures is not None and figures.images:
        lines.append(
            f"{figures.ticks} control steps, late by {figures.late_ms[0]:g} ms (median) and "
            f"{figures.late_ms[1]:g} ms (95 %); {figures.images_per_s:g} images/s while an episode ran."
        )
    lines.append(f"recordings  {folder}")
    if dataset is not None:
        lines.append(f"dataset     {dataset.root} ({counted(dataset.num_episodes, 'episode')})")
    if again:
        lines.append(f"Render them again, with other looks: {again}")
    return Group(table, unbroken("\n".join(lines)))


def _quality(row: Mapping[str, Any]) -> Quality:
    return Quality(**{key: float(row[key]) for key in ("seconds", "path_m", "idle_share")})


def _figures(quality: Quality) -> tuple[str, str, str]:
    return f"{quality.seconds:.1f}", f"{quality.path_m:.2f}", f"{100 * quality.idle_share:.0f}"
