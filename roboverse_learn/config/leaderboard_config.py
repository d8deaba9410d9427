"""Keys of ``roboverse leaderboard``."""

from dataclasses import dataclass


@dataclass(frozen=True, kw_only=True, slots=True)
class LeaderboardConfig:
    """``roboverse leaderboard``: tables, plots and page from the result files alone.

    Attributes:
        results_dir: Folder of results and of the leaderboard.
        prune_videos: Whether to remove videos: one success and one failure stay per entry and level, and
            what ``keep_videos.txt`` in the folder names.
    """

    results_dir: str = "results"
    prune_videos: bool = False
