"""Repairs of other packages, one file per cause."""
