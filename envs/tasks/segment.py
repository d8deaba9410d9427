"""A subtask, as a task may state it for trajectory augmentation."""

from collections.abc import Callable
from dataclasses import dataclass

from torch import Tensor

from envs.state import State


@dataclass(frozen=True, kw_only=True, slots=True)
class Segment:
    """A piece of every demonstration in which the hand moves relative to one object or part.

    Attributes:
        reference: Object, or ``object/part`` by the name of the part's joint.
        until: Returns whether the piece is over, (N,) bool; None is the end of the demonstration.
        carries: Object that the hand carries meanwhile; its path, not the hand's, is then repeated
            relative to ``reference``. Empty for none.
    """

    reference: str
    until: Callable[[State], Tensor] | None = None
    carries: str = ""
