"""Demonstrations of other projects: one reader per file format, and the replay in our environments."""
