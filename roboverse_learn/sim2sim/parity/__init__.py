"""Replays of recorded episodes in another simulator, by their states and by their controls."""
