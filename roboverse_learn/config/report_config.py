"""Configurations of the commands that only report: ``roboverse leaderboard`` and ``roboverse doctor``."""

from dataclasses import dataclass


@dataclass(frozen=True, kw_only=True, slots=True)
class LeaderboardConfig:
    """``roboverse leaderboard``: tables, plots and page from the result files alone.

    Attributes:
        results_dir: Folder of results and of the leaderboard.
    """

    results_dir: str = "results"


@dataclass(frozen=True, kw_only=True, slots=True)
class DoctorConfig:
    """``roboverse doctor``: the machine, the installation, and what works here.

    Attributes:
        json: Print JSON instead of text.
    """

    json: bool = False
