"""Parallel, crash-safe collection of demonstrations."""
