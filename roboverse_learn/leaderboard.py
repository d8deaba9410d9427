"""``python roboverse_learn/leaderboard.py``: tables, plots and page, from the result files alone."""

import sys
from pathlib import Path

if __name__ == "__main__":  # as a script: this folder's `data` or `run` must not hide other packages
    sys.path[0] = str(Path(__file__).resolve().parents[1])

from collections.abc import Callable, Iterable, Mapping
from dataclasses import asdict
from typing import TYPE_CHECKING, Any

from envs.core.errors import RoboVerseError
from roboverse_learn.config.other_commands import LeaderboardConfig

if TYPE_CHECKING:
    from rich.console import Group

    from roboverse_learn.commands.outcomes import Evaluation


def leaderboard(config: LeaderboardConfig) -> Any:
    """Writes the leaderboard of a folder of results, its videos pruned if asked; returns a printable report.

    Raises:
        ResultError: The folder is absent, or a file in it is no result; nothing is written then.
    """
    from roboverse_learn.commands.report import leaderboard_report

    results_dir = Path(config.results_dir)
    removed = _prune_videos(results_dir) if config.prune_videos else None
    return leaderboard_report(write_leaderboard(results_dir), removed)


def write_leaderboard(results_dir: Path) -> dict[str, Path]:
    """Writes ``leaderboard.*``, ``studies.*`` and the plots; returns what was written."""
    from benchmark.leaderboard.build import write
    from roboverse_learn.training.config import TrainConfig

    return write(results_dir, asdict(TrainConfig()))


def write_leaderboard_of(results_dir: Path, evaluations: "Iterable[Evaluation]") -> dict[str, Path]:
    """Writes the leaderboard of a folder; returns what concerns some evaluations.

    There are no plots of other tasks, and beside the pages, as ``result html`` and ``result studies html``,
    those of them that the evaluations are on.
    """
    from benchmark.leaderboard.pages import pages_of
    from benchmark.leaderboard.results_folder import PLOTS
    from benchmark.leaderboard.section_plots import possible_plots

    written = write_leaderboard(results_dir)
    paths = [each.path.relative_to(results_dir).as_posix() for each in evaluations if each.path]
    plots = possible_plots(results_dir, written["json"], paths)
    shown = {f"result {page}": written[page] for page in pages_of(written["json"], paths)}
    return shown | {
        kind: path for kind, path in written.items() if path.parent.name != PLOTS or path in plots
    }


def report_with_leaderboard(
    results_dir: Path, evaluations: "Iterable[Evaluation]", report: "Callable[[Mapping[str, Path]], Group]"
) -> "Group":
    """Writes the leaderboard of a folder; returns the report of it, also where it cannot be written.

    Args:
        results_dir: Folder of results.
        evaluations: As :func:`write_leaderboard_of`.
        report: Makes the report of the files of the leaderboard.
    """
    from roboverse_learn.commands.report import UnfinishedReport

    try:
        board = write_leaderboard_of(results_dir, evaluations)
    except RoboVerseError as error:  # an evaluation is shown, whatever other files hold
        return UnfinishedReport(report({}), str(error))
    return report(board)


def _prune_videos(results_dir: Path) -> int:
    """Removes the videos that :mod:`benchmark.leaderboard.video_rule` does not keep; returns their number."""
    from benchmark.leaderboard.build import build
    from benchmark.leaderboard.video_rule import remove_other_videos
    from roboverse_learn.training.config import TrainConfig

    return len(remove_other_videos(results_dir, build(results_dir, asdict(TrainConfig()))))


if __name__ == "__main__":
    from roboverse_learn.cli import script

    script("leaderboard")
