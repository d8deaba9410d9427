"""The interface between an expert and the rollout that follows it."""

from typing import Protocol

import numpy as np

from envs.state import State


class Planner(Protocol):
    """Turns states into actions. It keeps nothing between calls: an episode is the same in any order."""

    def plan(self, state: State, rng: np.random.Generator) -> np.ndarray:
        """Returns the next actions (T, A) float32 from a state of one row; T = 0 gives up.

        It is asked again from the state in which they end, until the task is solved or its time is over.
        """
        ...
