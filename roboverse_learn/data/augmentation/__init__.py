"""Trajectory augmentation: many demonstrations from a few, by moving their pieces with the objects."""
