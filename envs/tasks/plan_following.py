"""Executes a planner's plans in N environments."""

from collections.abc import Sequence

import numpy as np

from envs.state import State
from envs.tasks.planner import BatchPlanner, ExactBatchPlanner, Planner

TAIL_STEPS = 5
"""Control steps of a demonstration after success, so that a policy learns to stay."""


class PlanFollower:
    """Executes plans in N episodes and plans again where one is used up.

    Args:
        rngs: N generators, one per episode, for the planner.
        planner: Makes the plans.

    Attributes:
        success: Which episodes were solved at some step, (N,) bool.
    """

    def __init__(self, rngs: Sequence[np.random.Generator], planner: Planner) -> None:
        self._rngs, self._planner = rngs, planner
        count = len(rngs)
        self._plans: list[np.ndarray] = [np.zeros((0, 0), np.float32)] * count
        self._cursor = np.zeros(count, np.int64)
        self._left = np.full(count, -1)  # steps after success; -1 before it
        self._over = np.zeros(count, bool)
        self._last: list[np.ndarray | None] = [None] * count
        self.success = np.zeros(count, bool)

    def active(self, state: State) -> np.ndarray:
        """Returns the environments that act in this step; a used-up plan is replaced, from ``state``."""
        self._over |= self._left == 0
        ends = np.array([len(plan) for plan in self._plans])
        asking = np.flatnonzero(~self._over & (self._cursor >= ends))
        if len(asking):
            rngs = [self._rngs[env_id] for env_id in asking]
            for env_id, plan in zip(asking, plan_all(self._planner, state.select(asking), rngs), strict=True):
                last = self._last[env_id]
                if not len(plan) and self.success[env_id] and last is not None:
                    plan = last[None]
                self._plans[env_id], self._cursor[env_id] = plan, 0
                self._over[env_id] = not len(plan)
        return np.flatnonzero(~self._over)

    def next_actions(self) -> np.ndarray:
        """Returns the next action of every environment (N, A); one whose episode is over repeats its last."""
        for env_id in np.flatnonzero(~self._over):
            self._last[env_id] = self._plans[env_id][self._cursor[env_id]]
        known = next(last for last in self._last if last is not None)
        return np.stack([known if last is None else last for last in self._last])

    def record(self, active: np.ndarray, success: np.ndarray) -> None:
        """Records the outcome of a step; after its first success an episode lasts ``TAIL_STEPS`` more."""
        self._cursor[active] += 1
        counting = active[self._left[active] > 0]
        solved = active[success[active] & (self._left[active] < 0)]
        self._left[counting] -= 1
        self._left[solved] = TAIL_STEPS
        self.success[solved] = True


def plan_all(planner: Planner, state: State, rngs: Sequence[np.random.Generator]) -> list[np.ndarray]:
    """Returns a plan (T, A) for each row of ``state``, in one batch where the planner supports it."""
    if isinstance(planner, BatchPlanner):
        return planner.plan_batch(state, rngs)
    return plan_each(planner, state, rngs)


def plan_each(planner: Planner, state: State, rngs: Sequence[np.random.Generator]) -> list[np.ndarray]:
    """Returns a plan (T, A) for each row of ``state``, bit by bit as of that row alone."""
    if isinstance(planner, ExactBatchPlanner):
        return planner.plan_each(state, rngs)
    return [planner.plan(state.select([row]), rng) for row, rng in enumerate(rngs)]
