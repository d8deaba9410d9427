"""Shared parts of the commands: the run folder, the checkpoint under test, reports."""
