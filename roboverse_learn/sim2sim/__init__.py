"""Comparisons between simulators: replayed episodes and conserved quantities."""
