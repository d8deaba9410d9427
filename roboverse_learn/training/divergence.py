"""Training that has gone out of all bounds."""

from envs.core.errors import RoboVerseError


class TrainingDivergedError(RoboVerseError, ArithmeticError):
    """A loss or a weight is not a finite number any more."""
