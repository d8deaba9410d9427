"""Imitation learning: a policy learns the actions of a dataset."""
