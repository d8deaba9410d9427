"""Errors, the registry, atomic files: used by every other package. Standard library only."""
