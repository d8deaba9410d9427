"""The interface between an expert and the rollout that follows it."""

from collections.abc import Sequence
from typing import Protocol, runtime_checkable

import numpy as np

from envs.state import State


class Planner(Protocol):
    """Turns states into actions. It keeps nothing between calls: an episode is the same in any order."""

    def plan(self, state: State, rng: np.random.Generator) -> np.ndarray:
        """Returns the next actions (T, A) float32 from a state of one row; T = 0 gives up.

        It is called again from the state in which they end, until the task is solved or its time is over.
        """
        ...


@runtime_checkable
class ExactBatchPlanner(Planner, Protocol):
    """A planner that plans for many states in one call, and for each as for that one alone."""

    def plan_each(self, state: State, rngs: Sequence[np.random.Generator]) -> list[np.ndarray]:
        """Returns the next actions (T, A) from each row of ``state``: :meth:`plan`'s, bit by bit."""
        ...


@runtime_checkable
class BatchPlanner(Planner, Protocol):
    """A planner that is faster with many states at once."""

    def plan_batch(self, state: State, rngs: Sequence[np.random.Generator]) -> list[np.ndarray]:
        """Returns the next actions (T, A) from each row of ``state``: :meth:`plan`'s, up to rounding."""
        ...
