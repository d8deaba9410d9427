"""The leaderboard: tables, plots and pages, a pure function of the results files."""
