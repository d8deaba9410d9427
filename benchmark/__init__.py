"""Evaluation that can be trusted: protocol, runner, records, statistics, leaderboard.

Light to import: torch, scipy, matplotlib and the like are imported where they are used.
"""
