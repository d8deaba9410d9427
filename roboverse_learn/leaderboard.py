"""``python roboverse_learn/leaderboard.py``: tables, plots and page, from the result files alone."""

import sys
from pathlib import Path

if __name__ == "__main__":  # as a script: this folder's `data` or `run` must not hide other packages
    sys.path[0] = str(Path(__file__).resolve().parents[1])

from dataclasses import asdict
from typing import Any

from roboverse_learn.config.schema import LeaderboardConfig


def leaderboard(config: LeaderboardConfig) -> Any:
    """Writes the leaderboard of a folder of results; returns a printable report.

    Raises:
        ResultError: The folder is absent, or a file in it is no result; nothing is written then.
    """
    from roboverse_learn.commands.report import leaderboard_report

    return leaderboard_report(write_leaderboard(Path(config.results_dir)))


def write_leaderboard(results_dir: Path) -> dict[str, Path]:
    """Writes ``leaderboard.json``, ``.md``, ``.html`` and the plots; returns what was written."""
    from benchmark.leaderboard.build import write
    from roboverse_learn.training.config import TrainConfig

    return write(results_dir, asdict(TrainConfig()))


if __name__ == "__main__":
    from roboverse_learn.cli import script

    script("leaderboard")
